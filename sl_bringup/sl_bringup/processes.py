"""Executables of ROS packages as child processes that never outlive their owner.

Each child leads a process group of its own, so that Ctrl-C in the terminal reaches the owner alone, which then stops
its children in order: SIGINT first, SIGTERM and SIGKILL where that is not answered. Should the owner die without a
chance to do so, the kernel ends the children (Linux' parent death signal).
"""

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from sl_bringup.errors import ProcessError

_PR_SET_PDEATHSIG = 1


def share_folder(package: str) -> Path:
    """Return share/<package> of an installed package; raises ProcessError when it is not installed."""
    return _prefixes(package)[0] / "share" / package


def _prefixes(package: str) -> list[Path]:
    prefixes = [Path(p) for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    found = [p for p in prefixes if (p / "share/ament_index/resource_index/packages" / package).exists()]
    if not found:
        raise ProcessError(f"package '{package}' is not on AMENT_PREFIX_PATH: build the workspace and source env.sh")
    return found


def executable_path(package: str, name: str) -> Path:
    """Return the file that ``ros2 run package name`` executes.

    Raises ProcessError when the package or the executable is not installed.
    """
    found = _prefixes(package)
    for prefix in found:
        path = prefix / "lib" / package / name
        if os.access(path, os.X_OK):
            return path
    raise ProcessError(f"package '{package}' has no executable '{name}' in {found[0] / 'lib' / package}")


@dataclass(frozen=True)
class Executable:
    """What to start.

    Attributes:
        package: ROS package.
        name: Its executable.
        parameters: Node parameters, given on the command line.
        parameter_files: YAML files of parameters, before ``parameters``.
        remaps: Names to replace, from: to.
        arguments: Arguments before the ROS ones.
        label: Name of the log file and in messages; empty: the executable's name.
        niceness: Added to its scheduling niceness: what may be late gives way to what may not.
    """

    package: str
    name: str
    parameters: Mapping[str, object] | None = None
    parameter_files: Sequence[Path] = ()
    remaps: Mapping[str, str] | None = None
    arguments: Sequence[str] = ()
    label: str = ""
    niceness: int = 0

    def command(self) -> list[str]:
        """Return the command line; raises ProcessError when the executable is not installed."""
        ros: list[str] = []
        for file in self.parameter_files:
            ros += ["--params-file", str(file)]
        for key, value in (self.parameters or {}).items():
            ros += ["-p", f"{key}:={_parameter(value)}"]
        for old, new in (self.remaps or {}).items():
            ros += ["-r", f"{old}:={new}"]
        path = str(executable_path(self.package, self.name))
        return [path, *self.arguments, *(["--ros-args", *ros] if ros else [])]


def _parameter(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str | os.PathLike):
        return "'" + str(value).replace("'", "''") + "'"  # quoted: a folder named 1.0 stays a string
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_parameter(v) for v in value) + "]"
    return repr(value)


class Process:
    """A running child with its output in a log file."""

    def __init__(self, what: Executable, environment: Mapping[str, str], log_folder: Path) -> None:
        self.label = what.label or what.name
        self.log = log_folder / f"{self.label}.log"
        command = what.command()
        log_folder.mkdir(parents=True, exist_ok=True)
        with self.log.open("wb") as output:
            self._process = subprocess.Popen(
                command,
                env=dict(environment),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
                preexec_fn=_prepared(os.getpid(), what.niceness),
            )

    @property
    def pid(self) -> int:
        """Process id, which is also the group's."""
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        """Exit code, negative for a signal; None while it runs."""
        return self._process.poll()

    def output(self) -> str:
        """Everything it printed so far."""
        return self.log.read_text(encoding="utf-8", errors="replace")

    def last_line(self) -> str:
        """The last line it printed that is not empty."""
        lines = [line for line in self.output().splitlines() if line.strip()]
        return lines[-1] if lines else "no output"

    def signal(self, number: int) -> None:
        """Send a signal to its whole group."""
        try:
            os.killpg(self._process.pid, number)
        except ProcessLookupError:
            pass

    def wait(self, timeout: float) -> int | None:
        """Wait for its end for at most ``timeout`` [s]; returns the exit code, or None."""
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return None

    def stop(self, timeout: float = 8.0) -> int:
        """End it with SIGINT, after ``timeout`` [s] with SIGTERM, then SIGKILL; returns the exit code."""
        return stop_all([self], timeout)[self.label]


def stop_all(processes: Sequence[Process], timeout: float = 8.0) -> dict[str, int]:
    """Stop processes together; returns their exit codes by label, and leaves no member of their groups behind."""
    for number, patience in ((signal.SIGINT, timeout), (signal.SIGTERM, 2.0), (signal.SIGKILL, 5.0)):
        for process in processes:
            if process.returncode is None:
                process.signal(number)
        deadline = time.monotonic() + patience
        for process in processes:
            process.wait(max(deadline - time.monotonic(), 0.0))
        if all(p.returncode is not None for p in processes):
            break
    for process in processes:
        process.signal(signal.SIGKILL)  # whatever a child started and left
    return {p.label: p.returncode if p.returncode is not None else -signal.SIGKILL for p in processes}


class ProcessGroup:
    """Processes that live as long as a ``with`` block."""

    def __init__(self, environment: Mapping[str, str], log_folder: Path) -> None:
        self._environment = dict(environment)
        self._log_folder = log_folder
        self._processes: list[Process] = []

    def __enter__(self) -> "ProcessGroup":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def processes(self) -> tuple[Process, ...]:
        """All that were started, oldest first."""
        return tuple(self._processes)

    def start(self, what: Executable) -> Process:
        """Start an executable; from the main thread, which the parent death signal is bound to."""
        process = Process(what, self._environment, self._log_folder)
        self._processes.append(process)
        return process

    def check(self) -> None:
        """Raise ProcessError, with its last line, when a process has ended."""
        for process in self._processes:
            code = process.returncode
            if code is not None:
                raise ProcessError(
                    f"{process.label} ended with exit code {code}: {process.last_line()} (log: {process.log})"
                )

    def stop(self, timeout: float = 8.0) -> dict[str, int]:
        """Stop all; a Ctrl-C during that is put off until they are gone. Returns exit codes by label."""
        previous = None
        try:
            previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
        except ValueError:
            pass  # not in the main thread: there no Ctrl-C arrives
        try:
            return stop_all(self._processes, timeout)
        finally:
            if previous is not None:
                signal.signal(signal.SIGINT, previous)


def _prepared(parent: int, niceness: int) -> Callable[[], None]:
    """Return what the child does before it becomes the executable; all is looked up in the parent."""
    prctl = ctypes.CDLL(None, use_errno=True).prctl if sys.platform == "linux" else None

    def prepare() -> None:
        os.nice(niceness)
        if prctl is not None:
            prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it died in between
            os._exit(1)

    return prepare
