"""Targets are found in a process of its own, so that fitting a cloud never keeps the setpoints from the interpreter.

The process ends when its parent does, however that ends: its input is then at an end.
"""

import logging
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar, cast

from arm_positioner.errors import PositionerError
from arm_positioner.target import Target, find_target, other_targets

T = TypeVar("T")

_NICENESS = 0
"""The fit gives way to the setpoints where the node has raised its own priority."""


class TargetProcess:
    """Calls the functions of :mod:`arm_positioner.target` elsewhere; falls back to this process where that fails."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._start()

    def find(self, *args: Any, **kwargs: Any) -> Target:
        """Return what find_target returns for the same arguments, or raise what it raises."""
        return self._call(find_target, args, kwargs)

    def others(self, *args: Any, **kwargs: Any) -> list[Target]:
        """Return what other_targets returns for the same arguments, or raise what it raises."""
        return self._call(other_targets, args, kwargs)

    def _call(self, function: Callable[..., T], args: tuple[Any, ...], kwargs: dict[str, Any]) -> T:
        with self._lock:
            try:
                answer = self._ask((function, args, kwargs))
            except (OSError, EOFError, pickle.UnpicklingError) as error:
                logging.getLogger(__name__).warning("target process lost (%s): started anew", error)
                self._start()
                return function(*args, **kwargs)
        if isinstance(answer, PositionerError):
            raise answer
        return cast(T, answer)

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        process.stdin.close()
        try:
            process.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _start(self) -> None:
        self.close()
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment
        )

    def _ask(self, call: tuple[Callable[..., Any], tuple[Any, ...], dict[str, Any]]) -> Any:
        if self._process is None:
            raise EOFError("closed")
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        pickle.dump(call, self._process.stdin, protocol=pickle.HIGHEST_PROTOCOL)
        self._process.stdin.flush()
        return pickle.load(self._process.stdout)


def serve() -> None:
    """Answer calls from standard input until it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a Ctrl-C in the terminal is the parent's to handle
    with suppress(OSError, AttributeError):
        os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # whatever prints must not spoil the answers
    while True:
        try:
            function, args, kwargs = pickle.load(requests)
        except EOFError:
            return
        try:
            answer = function(*args, **kwargs)
        except PositionerError as error:
            answer = error
        except Exception as error:  # a defect in the fit must not end the service
            answer = PositionerError(f"the surface fit failed: {error!r}")
        pickle.dump(answer, answers, protocol=pickle.HIGHEST_PROTOCOL)
        answers.flush()


if __name__ == "__main__":
    serve()
