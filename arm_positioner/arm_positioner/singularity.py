"""Nearness to a singularity, by the condition number of the geometric Jacobian."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sl_common.kinematics import Kinematics

Array = NDArray[np.float64]

_LEAVING_MARGIN = 1.1
"""How much the condition number may rise again while an arm is led out of a singularity."""


@dataclass(frozen=True)
class SingularityThresholds:
    """Condition numbers [1] between which an arm is slowed down and past which it is stopped.

    Attributes:
        slow: Full speed up to here.
        stop: Standstill from here on.
        least_speed: Factor on the velocity limits just before ``stop``.
    """

    slow: float = 40.0
    stop: float = 100.0
    least_speed: float = 0.1

    def speed(self, condition: float) -> float:
        """Return the factor on the velocity limits at a condition number: linear, from 1 to ``least_speed``."""
        if not condition > self.slow:
            return 1.0
        share = min((condition - self.slow) / (self.stop - self.slow), 1.0)
        return 1.0 - share * (1.0 - self.least_speed)


def condition_number(jacobian: Array) -> Array:
    """Return the condition numbers [1] of geometric Jacobians (..., 6, n) in m and rad; inf: singular."""
    values = np.linalg.svd(jacobian, compute_uv=False)
    smallest = values[..., -1]
    return np.where(smallest > 1e-12, values[..., 0] / np.maximum(smallest, 1e-12), np.inf)


class SingularityWatch:
    """Tells when the condition number says stop, along a path or in time.

    An arm that starts inside a singular region may leave it: there the limit is the lowest condition number seen so far
    (with a small margin) instead of the threshold, so it may only get better.
    """

    def __init__(self, thresholds: SingularityThresholds) -> None:
        self._thresholds = thresholds
        self._lowest = np.inf

    def allows(self, condition: float) -> bool:
        """Take the next condition number and tell whether the arm may be there."""
        limit = max(self._thresholds.stop, _LEAVING_MARGIN * self._lowest)
        self._lowest = min(self._lowest, condition)
        return bool(condition <= limit)


def conditions_along(kinematics: Kinematics, path: Array) -> Array:
    """Return the condition numbers (N,) at joint positions (N, n)."""
    return condition_number(np.stack([kinematics.jacobian(q) for q in path]))


def first_violation(conditions: Array, thresholds: SingularityThresholds) -> int:
    """Return the index of the first of the condition numbers (N,) along a path that is not allowed; -1: none."""
    watch = SingularityWatch(thresholds)
    return next((i for i, c in enumerate(conditions.tolist()) if not watch.allows(c)), -1)
