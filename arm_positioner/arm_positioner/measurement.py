"""What is known of the arm from joint states, and how it compares with what was commanded."""

from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class MeasuredJoints:
    """The joint states of the last moments.

    Args:
        window: Length of time over which rest is judged [s].
        rest_motion: Largest change of a joint within the window that counts as rest [rad or m].
    """

    def __init__(self, *, window: float = 0.1, rest_motion: float = 1e-3) -> None:
        self._window, self._rest_motion = window, rest_motion
        self._samples: deque[tuple[float, Array]] = deque(maxlen=1000)

    def add(self, time: float, positions: ArrayLike) -> None:
        """Take positions (n,) measured at ``time`` [s]; those older than the newest are dropped."""
        if self._samples and time <= self._samples[-1][0]:
            return
        self._samples.append((time, np.array(positions, dtype=np.float64)))
        while time - self._samples[0][0] > 4 * self._window:
            self._samples.popleft()

    @property
    def newest(self) -> Array | None:
        """The newest positions (n,)."""
        return self._samples[-1][1] if self._samples else None

    @property
    def newest_time(self) -> float:
        """Time of the newest positions [s]; -inf: none yet."""
        return self._samples[-1][0] if self._samples else -np.inf

    def motion(self) -> Array | None:
        """Return the range of motion (n,) over the window; None while fewer than two states span half of it."""
        recent = self._recent()
        if len(recent) < 2 or recent[-1][0] - recent[0][0] < 0.5 * self._window:
            return None
        positions = np.array([q for _, q in recent])
        return np.ptp(positions, axis=0)

    def rest_position(self, since: float = -np.inf) -> Array | None:
        """Return the mean positions (n,) over the window where the arm is at rest in all of it, else None.

        Args:
            since: Time before which the window must not begin [s].
        """
        motion = self.motion()
        if motion is None or (motion > self._rest_motion).any() or self._recent()[0][0] < since:
            return None
        return np.mean([q for _, q in self._recent()], axis=0)

    def _recent(self) -> list[tuple[float, Array]]:
        return [s for s in self._samples if s[0] >= self.newest_time - self._window]


class CommandHistory:
    """The setpoints of the last moments, to tell whether the driver follows them.

    Args:
        lag: Longest delay of a driver that still counts as following [s].
    """

    def __init__(self, lag: float) -> None:
        self._lag = lag
        self._samples: deque[tuple[float, Array]] = deque()

    def clear(self) -> None:
        """Forget all setpoints."""
        self._samples.clear()

    def add(self, time: float, positions: Array) -> None:
        """Take a setpoint (n,) that left at ``time`` [s]."""
        self._samples.append((time, positions))
        # one sample older than the window stays: it was in force when the window began
        while len(self._samples) > 1 and self._samples[1][0] < time - 2 * self._lag:
            self._samples.popleft()

    def deviation(self, time: float, measured: Array) -> Array:
        """Return how far positions (n,) measured at ``time`` are off what was commanded in the lag before."""
        begin = time - self._lag
        inside = [q for t, q in self._samples if begin <= t <= time + 0.02]
        older = [q for t, q in self._samples if t < begin]
        window = np.array(older[-1:] + inside if older or inside else [q for _, q in list(self._samples)[:1]])
        if window.size == 0:
            return np.zeros_like(measured)
        return np.maximum(np.maximum(window.min(axis=0) - measured, measured - window.max(axis=0)), 0.0)
