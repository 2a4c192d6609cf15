"""``ros2 run sl_bringup benchmark``: the performance table of all packages."""

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path

from sl_bringup.demo.report import Row, passed, table
from sl_bringup.errors import BenchmarkError
from sl_bringup.isolation import environment, free_domain
from sl_bringup.terminal import Terminal
from sl_common.commands import UsageError, make_parser, run_command
from sl_common.errors import StructuredLightError
from sl_common.files import write_text

_EXAMPLE = """  ros2 run sl_bringup benchmark --only sl_decoder decoder_node --json bench.json

The exit code is 0 when every row with a limit keeps it."""

NODE = "decoder_node"


def _parser() -> argparse.ArgumentParser:
    from sl_bringup.benchmarks.packages import available

    choices = [*available(), NODE]
    parser = make_parser(
        "sl_bringup benchmark",
        "Measure every package on this machine and print one table: name, value, unit, limit.",
        _EXAMPLE,
    )
    parser.add_argument("--only", nargs="+", choices=choices, default=choices, help="which parts (default: all)")
    parser.add_argument(
        "--seconds", type=float, default=5.0, help="per rate of the decoder node (default: %(default)s)"
    )
    parser.add_argument("--domain-id", type=int, help="ROS domain (default: one that nobody uses)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows as JSON too")
    return parser


def _run(options: argparse.Namespace) -> int:
    if options.seconds <= 0:
        raise UsageError(f"--seconds {options.seconds:g} must be positive")
    rows = _rows(options)
    if options.json:
        write_text(options.json, json.dumps([row.as_dict() for row in rows], indent=1) + "\n")
    print(table(rows))
    return 0 if passed(rows) else 1


def _rows(options: argparse.Namespace) -> list[Row]:
    terminal = Terminal(sys.stderr)
    rows: list[Row] = []
    for part in options.only:
        terminal.step(f"measuring {part}")
        if part == NODE:
            rows += _node_rows(options)
            continue
        from sl_bringup.benchmarks.packages import package_rows

        try:
            rows += package_rows(part)
        except StructuredLightError:
            raise
        except Exception as error:
            raise BenchmarkError(f"the benchmark of {part} failed: {type(error).__name__}: {error}") from error
    return rows


def _node_rows(options: argparse.Namespace) -> list[Row]:
    with free_domain(options.domain_id) as domain, tempfile.TemporaryDirectory() as logs:
        os.environ.update(environment(domain))
        from sl_bringup.benchmarks.decoder_node import decoder_node_rows

        return decoder_node_rows(domain, Path(logs), options.seconds)


def main(arguments: list[str] | None = None) -> int:
    """Run the command."""
    return run_command(_parser(), _run, arguments)


if __name__ == "__main__":
    sys.exit(main())
