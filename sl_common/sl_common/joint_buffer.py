"""Joint positions at the stamp of an image, interpolated between the joint states around it."""

from bisect import bisect_left, bisect_right
from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sl_common.errors import InvalidInputError, StructuredLightError

_NS = 1e-9


class JointLookupError(StructuredLightError):
    """No joint positions can be given for a stamp."""


class TooEarly(JointLookupError):  # noqa: N818 (names the condition)
    """The stamp lies before the oldest joint state kept."""


class TooLate(JointLookupError):  # noqa: N818
    """The stamp lies after the newest joint state: wait for the next one."""


class Gap(JointLookupError):  # noqa: N818
    """The joint states around the stamp are too far apart."""


class JointBuffer:
    """The latest joint states, ordered by stamp.

    Nothing is ever extrapolated: a stamp outside the buffer or inside a gap is refused.
    """

    def __init__(self, *, max_gap: float = 0.1, horizon: float = 5.0) -> None:
        """Keep ``horizon`` [s] of joint states; refuse to interpolate over more than ``max_gap`` [s]."""
        self._max_gap = round(max_gap / _NS)
        self._horizon = round(horizon / _NS)
        self._stamps: deque[int] = deque()
        self._positions: deque[NDArray[np.float64]] = deque()

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def newest(self) -> tuple[int, NDArray[np.float64]] | None:
        """The newest stamp [ns] and its positions (n,), or None."""
        return (self._stamps[-1], self._positions[-1]) if self._stamps else None

    def add(self, stamp: int, positions: ArrayLike) -> None:
        """Insert positions (n,) at ``stamp`` [ns]; late messages are put in their place, repeated stamps replaced.

        A jump back by more than the horizon (a restarted clock or bag) clears the buffer. Raises InvalidInputError for
        values that are not finite or of another length than before.
        """
        q = np.array(positions, dtype=np.float64)
        if not np.all(np.isfinite(q)):
            raise InvalidInputError(f"joint positions are not finite: {q.tolist()}")
        if self._positions and q.shape != self._positions[-1].shape:
            raise InvalidInputError(f"{q.size} joint positions, expected {self._positions[-1].size}")
        if self._stamps and stamp < self._stamps[-1] - self._horizon:
            self.clear()
        i = bisect_left(self._stamps, stamp)
        if i < len(self._stamps) and self._stamps[i] == stamp:
            self._positions[i] = q
        else:
            self._stamps.insert(i, stamp)
            self._positions.insert(i, q)
        while self._stamps[-1] - self._stamps[0] > self._horizon:
            self._stamps.popleft()
            self._positions.popleft()

    def clear(self) -> None:
        """Forget everything."""
        self._stamps.clear()
        self._positions.clear()

    def at(self, stamp: int) -> NDArray[np.float64]:
        """Return the positions (n,) at ``stamp`` [ns], linearly interpolated.

        Raises TooEarly, TooLate or Gap, with the distance in seconds.
        """
        if not self._stamps:
            raise TooLate("no joint state received yet")
        if stamp > self._stamps[-1]:
            raise TooLate(f"stamp is {(stamp - self._stamps[-1]) * _NS:.3f} s after the newest joint state")
        if stamp < self._stamps[0]:
            raise TooEarly(f"stamp is {(self._stamps[0] - stamp) * _NS:.3f} s before the oldest joint state kept")
        i = bisect_right(self._stamps, stamp)
        t0 = self._stamps[i - 1]
        if t0 == stamp:
            return self._positions[i - 1].copy()
        t1 = self._stamps[i]
        if t1 - t0 > self._max_gap:
            raise Gap(
                f"joint states around the stamp are {(t1 - t0) * _NS:.3f} s apart, limit {self._max_gap * _NS:.3f} s"
            )
        s = (stamp - t0) / (t1 - t0)
        return (1 - s) * self._positions[i - 1] + s * self._positions[i]
