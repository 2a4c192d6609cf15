# `make demo` and `make test` each set everything up by themselves; see README.md.
SHELL := /bin/bash
ENV := source ./env.sh

.PHONY: help setup build demo test bench lint clean
help:
	@echo "make demo    set up, build, and run the simulated cell: an arm positions itself in front of an object"
	@echo "make test    set up, build, and run all tests"
	@echo "make bench   set up, build, and print the performance table"
	@echo "make lint    ruff and mypy"
	@echo "make build   set up and build only"
	@echo "make clean   remove build products and outputs (make distclean: the venv too)"

setup:
	@workspace/setup.sh

build: setup
	@workspace/build.sh

demo: build
	@$(ENV) && ros2 run sl_bringup demo $(DEMO_ARGS)

test: build
	@$(ENV) && python -m pytest $(PYTEST_ARGS)

bench: build
	@$(ENV) && ros2 run sl_bringup benchmark $(BENCH_ARGS)

lint: build
	@$(ENV) && ruff check . && ruff format --check . && workspace/mypy.sh

clean:
	rm -rf build install log demo_output bench_output .pytest_cache .hypothesis .mypy_cache .ruff_cache .build.lock
	find . -path ./.venv -prune -o \( -name __pycache__ -o -name '*.egg-info' \) -type d -print0 | xargs -0 rm -rf

distclean: clean
	rm -rf .venv
