"""The running system: all nodes as processes of their own, the observer in this one."""

import os
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

from sl_bringup.bag.writer import BackgroundWriter
from sl_bringup.errors import DemoError
from sl_bringup.isolation import environment, free_domain
from sl_bringup.processes import Executable, ProcessGroup
from sl_bringup.ros.observer import Observer
from sl_bringup.ros.participant import Thread, participating, served
from sl_bringup.terminal import Terminal


class Session:
    """Starts processes and observer; ends them, in whatever way the ``with`` block is left.

    Attributes:
        observer: The node that hears everything.
        thread: Where its callbacks run.
        processes: The nodes.
        domain: ROS domain of all of them.
    """

    observer: Observer
    thread: Thread
    processes: ProcessGroup
    domain: int

    def __init__(
        self, terminal: Terminal, log_folder: Path, *, domain: int | None = None, bag: BackgroundWriter | None = None
    ) -> None:
        self._terminal, self._log_folder = terminal, log_folder
        self._wanted_domain, self._bag = domain, bag
        self._stack = ExitStack()

    def __enter__(self) -> "Session":
        with ExitStack() as stack:
            self.domain = stack.enter_context(free_domain(self._wanted_domain))
            os.environ.update(environment(self.domain))
            self.processes = stack.enter_context(ProcessGroup(os.environ, self._log_folder))
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def start(self, executables: list[Executable]) -> None:
        """Start the processes, then the observer: after it this process has threads and forks no more."""
        for executable in executables:
            self.processes.start(executable)
        self._stack.enter_context(participating())
        self.observer = Observer(self._bag)
        self.thread = self._stack.enter_context(served(self.observer))

    def wait_for(
        self, condition: Callable[[], Any], timeout: float, what: str, live: Callable[[], str] | None = None
    ) -> Any:
        """Wait until ``condition`` gives something true, and return it.

        Args:
            condition: Asked twenty times a second.
            timeout: How long at most [s].
            what: Completes "did not come about: ..." in the error.
            live: Gives the live line of the terminal.

        Raises DemoError after the timeout, ProcessError when a node dies.
        """
        deadline = time.monotonic() + timeout
        while not (value := condition()):
            self.processes.check()
            if time.monotonic() > deadline:
                raise DemoError(f"within {timeout:.0f} s this did not come about: {what}; logs in {self._log_folder}")
            if live is not None:
                self._terminal.live(live())
            time.sleep(0.05)
        return value

    def wait(self, seconds: float, live: Callable[[], str] | None = None) -> None:
        """Let ``seconds`` pass, watching the processes."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.processes.check()
            if live is not None:
                self._terminal.live(live())
            time.sleep(0.05)
