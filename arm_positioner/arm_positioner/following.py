"""Smoothing and prediction of a target that is measured now and then."""

import numpy as np
from numpy.typing import NDArray

from sl_common import transforms

Array = NDArray[np.float64]

_OUTLIERS = 3
"""Consecutive measurements past the gate after which they are believed."""


class TargetFilter:
    """A critically damped g-h filter over poses: constant velocity, exponentially fading memory.

    Measurements come with delay and at irregular times; :meth:`at` extrapolates the pose to the present, so that a
    steadily moving target is met without lag. A single measurement far off is ignored.
    """

    def __init__(
        self,
        *,
        time_constant: float = 0.15,
        max_speed: float = 0.5,
        max_rate: float = 1.0,
        gate: float = 0.1,
        horizon: float = 0.5,
    ) -> None:
        """Set up an empty filter.

        Args:
            time_constant: Memory [s].
            max_speed: Largest believed speed of the target [m/s].
            max_rate: Largest believed angular speed [rad/s].
            gate: Jump of the position past which a measurement is doubted [m].
            horizon: Longest extrapolation [s].
        """
        self._time_constant, self._gate, self._horizon = time_constant, gate, horizon
        self._max = (max_speed, max_rate)
        self._pose: Array | None = None
        self._twist = np.zeros(6)
        self._time = 0.0
        self._doubted = 0

    def reset(self) -> None:
        """Forget the target."""
        self._pose, self._twist, self._doubted = None, np.zeros(6), 0

    def update(self, time: float, pose: Array) -> bool:
        """Take a pose (4, 4) measured at ``time`` [s]; returns False where it was ignored as old or doubtful."""
        if self._pose is None:
            self._pose, self._time, self._twist = pose.copy(), time, np.zeros(6)
            return True
        step = time - self._time
        if step <= 0:
            return False
        predicted = transforms.perturb(self._pose, self._twist * min(step, self._horizon))
        innovation = transforms.difference(predicted, pose)
        if np.linalg.norm(innovation[:3]) > self._gate:
            self._doubted += 1
            if self._doubted < _OUTLIERS:
                return False
            self.reset()
            return self.update(time, pose)
        self._doubted = 0
        theta = np.exp(-step / self._time_constant)
        self._pose = transforms.perturb(predicted, (1 - theta**2) * innovation)
        self._twist = self._bounded(self._twist + (1 - theta) ** 2 / step * innovation)
        self._time = time
        return True

    def at(self, time: float) -> Array:
        """Return the pose (4, 4) expected at ``time`` [s], extrapolated over at most the horizon."""
        if self._pose is None:
            raise ValueError("no target measured yet")
        return transforms.perturb(self._pose, self._twist * np.clip(time - self._time, 0.0, self._horizon))

    @property
    def speed(self) -> float:
        """Estimated speed of the target [m/s]."""
        return float(np.linalg.norm(self._twist[:3]))

    def _bounded(self, twist: Array) -> Array:
        for part, limit in zip((slice(0, 3), slice(3, 6)), self._max, strict=True):
            twist[part] *= min(1.0, limit / max(float(np.linalg.norm(twist[part])), 1e-12))
        return twist
