"""Nearness to a singularity, by the condition number of the Jacobian in units of the arm's own size.

The raw number of the geometric Jacobian compares metres with radians, so that it depends on the unit of length. Here a
turn of one radian counts like the way it makes at the arm's characteristic length, the root mean square distance of its
revolute axes from the tip over all postures (Angeles, Fundamentals of Robotic Mechanical Systems, on homogenised
Jacobians). For an arm with a reach of 0.85 m that is about 0.35 m, and the number half the raw one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sl_common.kinematics import Kinematics

Array = NDArray[np.float64]

_POSTURES = 200
"""Random postures over which the levers of an arm are averaged."""
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
    """Return the condition numbers [1] of Jacobians (..., 6, n); inf: singular."""
    values = np.linalg.svd(jacobian, compute_uv=False)
    smallest = values[..., -1]
    return np.where(smallest > 1e-12, values[..., 0] / np.maximum(smallest, 1e-12), np.inf)


class Conditioning:
    """The condition number of an arm's homogenised Jacobian.

    Attributes:
        length: Characteristic length of the arm [m].
    """

    def __init__(self, kinematics: Kinematics) -> None:
        """Use ``kinematics`` from the thread of the caller."""
        self._kinematics = kinematics
        rng = np.random.default_rng(0)
        low, high = np.maximum(kinematics.lower, -np.pi), np.minimum(kinematics.upper, np.pi)
        jacobians = np.stack([kinematics.jacobian(q) for q in rng.uniform(low, high, (_POSTURES, low.size))])
        revolute = np.linalg.norm(jacobians[0, 3:], axis=0) > 0.5
        levers = np.linalg.norm(jacobians[:, :3, revolute], axis=1)
        self.length = float(np.sqrt(np.mean(levers**2))) if levers.size and levers.any() else 1.0
        self._rows = np.repeat((1 / self.length, 1.0), 3)[:, None]
        self._columns = np.where(revolute, 1.0, self.length)

    def at(self, position: Array) -> float:
        """Return the condition number at joint positions (n,)."""
        return float(self.along(position[None])[0])

    def along(self, path: Array) -> Array:
        """Return the condition numbers (N,) at joint positions (N, n)."""
        jacobians = np.stack([self._kinematics.jacobian(q) for q in path])
        return condition_number(self._rows * jacobians * self._columns)


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


def first_violation(conditions: Array, thresholds: SingularityThresholds) -> int:
    """Return the index of the first of the condition numbers (N,) along a path that is not allowed; -1: none."""
    watch = SingularityWatch(thresholds)
    return next((i for i, c in enumerate(conditions.tolist()) if not watch.allows(c)), -1)
