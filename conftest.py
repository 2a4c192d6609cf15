"""Settings of all tests: property tests draw the same examples in every run, and nothing is timed.

Modules marked ``processes`` run real nodes. They take turns, over all workers: two sets of nodes at once on a small
machine, and joint states come late. Algorithms are tested beside them meanwhile.
"""

import fcntl
import os
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import pytest
from hypothesis import settings

settings.register_profile("repeatable", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("repeatable")

# A shell's background job ignores Ctrl-C, and so would all that the tests start and interrupt.
signal.signal(signal.SIGINT, signal.default_int_handler)

_turn: IO[str] | None = None


def _uses_processes(item: pytest.Item | None) -> bool:
    return item is not None and item.get_closest_marker("processes") is not None


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    """Hold the turn from the first test with processes to the last one in a row; waiting is outside of time limits."""
    global _turn
    if _turn is None and _uses_processes(item):
        _turn = (Path(tempfile.gettempdir()) / f"structured_light_tests.{os.getuid()}.lock").open("w")
        fcntl.flock(_turn, fcntl.LOCK_EX)
    result = yield
    if _turn is not None and not (_uses_processes(nextitem) and nextitem.path == item.path):
        _turn.close()
        _turn = None
    return result
