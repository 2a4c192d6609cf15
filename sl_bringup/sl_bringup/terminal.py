"""Progress in the terminal: one line per step, and a live line under it where there is a terminal to overwrite."""

import shutil
import sys
import time
from typing import TextIO


class Terminal:
    """Prints steps with the time since the start; a live line shows figures while a step goes on."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stdout
        self._tty = self._stream.isatty()
        self._start = time.monotonic()
        self._last_live = 0.0
        self._live = False

    def step(self, text: str) -> None:
        """Print a line that stays."""
        self._clear()
        self._write(f"[{time.monotonic() - self._start:6.1f} s] {text}\n")

    def plain(self, text: str) -> None:
        """Print text without a time."""
        self._clear()
        self._write(f"{text}\n")

    def live(self, text: str) -> None:
        """Show figures of the moment: five times a second on a terminal, every ten seconds in a log."""
        now = time.monotonic()
        if now - self._last_live < (0.2 if self._tty else 10.0):
            return
        self._last_live = now
        if not self._tty:
            self._write(f"[{now - self._start:6.1f} s]   {text}\n")
            return
        width = shutil.get_terminal_size().columns
        self._write("\r" + f"[{now - self._start:6.1f} s]   {text}"[: width - 1].ljust(width - 1))
        self._live = True

    def _clear(self) -> None:
        if self._live:
            self._write("\r" + " " * (shutil.get_terminal_size().columns - 1) + "\r")
            self._live = False

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()
