"""The thread that sends one setpoint per control period."""

import gc
import os
import sys
import threading
import time
from collections import deque
from collections.abc import Callable

import numpy as np

_LATE = 0.25
"""Share of the period by which a tick may be late and still be followed by one on the old grid."""
_NICENESS = -10
"""Priority of the node where the user may raise it."""
_SWITCH_INTERVAL = 5e-4
"""How long another Python thread may hold the interpreter while this one is due [s]."""


def raise_priority() -> bool:
    """Let this thread, and those it starts from now on, go before others; returns whether the system permits it.

    All threads of a node need it, not only the one that sends setpoints: on Linux priorities count per thread, and a
    thread that waits for its turn while it holds the interpreter keeps the setpoints waiting too.
    """
    try:
        os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)
    except (OSError, AttributeError):
        return False
    return True


class SetpointLoop:
    """Calls a function every period from a thread of its own.

    A tick that comes late shifts the grid: it is neither made up for by a second one close behind, nor skipped, since
    both would look to the driver like a jump.
    """

    def __init__(self, period: float, tick: Callable[[], None]) -> None:
        """Call ``tick`` every ``period`` [s] once :meth:`start` has been called."""
        self.period = period
        self._tick = tick
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="setpoints", daemon=True)
        self._intervals: deque[float] = deque(maxlen=2000)
        self._work: deque[float] = deque(maxlen=2000)
        self.failure: BaseException | None = None

    def start(self) -> None:
        """Start the thread."""
        sys.setswitchinterval(_SWITCH_INTERVAL)
        gc.collect()
        gc.freeze()  # what exists now lives as long as the node: spare the collector walking it in mid-stream
        self._thread.start()

    def stop(self) -> None:
        """End the thread after the tick that runs."""
        self._stop.set()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(timeout=1.0)

    @property
    def is_alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def jitter(self) -> dict[str, float]:
        """Return the mean, 99th percentile and maximum interval and the mean and maximum work per tick [ms]."""
        if len(self._intervals) < 2:
            return {}
        intervals, work = 1e3 * np.array(self._intervals), 1e3 * np.array(self._work)
        return {
            "interval mean [ms]": float(intervals.mean()),
            "interval p99 [ms]": float(np.percentile(intervals, 99)),
            "interval max [ms]": float(intervals.max()),
            "work mean [ms]": float(work.mean()),
            "work max [ms]": float(work.max()),
        }

    def _run(self) -> None:
        due = time.monotonic() + self.period
        last = None
        while not self._stop.is_set():
            now = time.monotonic()
            if now < due:
                time.sleep(due - now)
                continue
            if last is not None:
                self._intervals.append(now - last)
            last = now
            try:
                self._tick()
            except Exception as error:  # the node reports it; without setpoints the driver holds
                self.failure = error
                return
            self._work.append(time.monotonic() - now)
            due = (due if now - due < _LATE * self.period else now) + self.period
