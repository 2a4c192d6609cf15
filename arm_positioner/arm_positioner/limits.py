"""Limits of the joints in position, velocity, acceleration and jerk."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_positioner.errors import InvalidGoalError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class JointLimits:
    """What every setpoint has to respect; arrays are read-only.

    Attributes:
        names: The n joints.
        lower: (n,) lower position limits [rad or m]; -inf: none.
        upper: (n,) upper position limits [rad or m]; inf: none.
        velocity: (n,) largest speed [rad/s or m/s].
        acceleration: (n,) largest acceleration [rad/s^2 or m/s^2].
        jerk: (n,) largest jerk [rad/s^3 or m/s^3].

    Raises InvalidGoalError for arrays of another length, numbers that are not positive, and empty position ranges.
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    jerk: Array

    def __post_init__(self) -> None:
        for item in fields(self)[1:]:
            values = np.array(getattr(self, item.name), dtype=np.float64)
            if values.shape != (self.size,):
                raise InvalidGoalError(f"{item.name} limits: {values.size} numbers for {self.size} joints")
            if np.isnan(values).any():
                raise InvalidGoalError(f"{item.name} limits contain NaN: {values.tolist()}")
            if item.name in ("velocity", "acceleration", "jerk"):
                self._require_positive(item.name, values)
            values.flags.writeable = False
            object.__setattr__(self, item.name, values)
        for name, low, high in zip(self.names, self.lower, self.upper, strict=True):
            if not low < high:
                raise InvalidGoalError(f"joint {name}: lower limit {low:g} is not below upper limit {high:g}")

    def _require_positive(self, kind: str, values: Array) -> None:
        for name, value in zip(self.names, values, strict=True):
            if not (0 < value < np.inf):
                raise InvalidGoalError(
                    f"joint {name}: {kind} limit {value:g} must be positive and finite; set parameter max_{kind}"
                )

    @property
    def size(self) -> int:
        """Number of joints n."""
        return len(self.names)

    def scaled(self, *, velocity: float = 1.0, acceleration: float = 1.0, jerk: float = 1.0) -> "JointLimits":
        """Return limits with speed, acceleration and jerk multiplied by the factors given."""
        return JointLimits(
            self.names,
            self.lower,
            self.upper,
            self.velocity * velocity,
            self.acceleration * acceleration,
            self.jerk * jerk,
        )

    def inside(self, margin: float) -> tuple[Array, Array]:
        """Return lower and upper limits (n,) moved inwards by ``margin``, at most by a quarter of the range."""
        shift = np.minimum(margin, 0.25 * (self.upper - self.lower))
        return self.lower + shift, self.upper - shift

    def outside(self, positions: ArrayLike, tolerance: float = 0.0) -> str:
        """Name the first joint of positions (n,) outside its limits, with the numbers; empty: all inside."""
        q = np.asarray(positions, dtype=np.float64)
        bad = np.flatnonzero((q < self.lower - tolerance) | (q > self.upper + tolerance))
        if bad.size == 0:
            return ""
        i = int(bad[0])
        return f"joint {self.names[i]} at {q[i]:.4f} is outside its limits {self.lower[i]:.4f} to {self.upper[i]:.4f}"


def from_urdf(
    names: Sequence[str],
    lower: ArrayLike,
    upper: ArrayLike,
    urdf_velocity: ArrayLike,
    *,
    velocity_scale: float = 1.0,
    max_velocity: Sequence[float] = (),
    max_acceleration: Sequence[float],
    max_jerk: Sequence[float],
) -> JointLimits:
    """Combine what the URDF says with the parameters; the smaller of two velocity limits holds.

    Args:
        names: The n joints.
        lower: (n,) lower position limits of the URDF [rad or m].
        upper: (n,) upper position limits of the URDF [rad or m].
        urdf_velocity: (n,) velocity limits of the URDF [rad/s or m/s]; inf: none.
        velocity_scale: Factor on the URDF's velocities, in (0, 1].
        max_velocity: n numbers, one for all joints, or none: the URDF's alone.
        max_acceleration: n numbers or one for all joints.
        max_jerk: n numbers or one for all joints.

    Raises InvalidGoalError for a list of another length or a number that is not positive.
    """
    n = len(names)
    velocity = velocity_scale * np.asarray(urdf_velocity, dtype=np.float64)
    if len(max_velocity):
        velocity = np.minimum(velocity, _per_joint("max_velocity", max_velocity, n))
    return JointLimits(
        tuple(names),
        np.asarray(lower, dtype=np.float64),
        np.asarray(upper, dtype=np.float64),
        velocity,
        _per_joint("max_acceleration", max_acceleration, n),
        _per_joint("max_jerk", max_jerk, n),
    )


def _per_joint(name: str, values: Sequence[float], n: int) -> Array:
    if len(values) not in (1, n):
        raise InvalidGoalError(f"parameter {name} has {len(values)} numbers, expected 1 or {n} (one per joint)")
    return np.broadcast_to(np.asarray(values, dtype=np.float64), (n,)).copy()


def command_order(names: Sequence[str], wanted: Sequence[str]) -> NDArray[np.int64]:
    """Return the index (n,) into ``names`` of each joint of ``wanted``; nothing wanted: the order of ``names``.

    Raises InvalidGoalError where the two are not the same joints.
    """
    if not wanted:
        return np.arange(len(names), dtype=np.int64)
    if sorted(wanted) != sorted(names):
        raise InvalidGoalError(
            f"parameter joints is {', '.join(wanted)}, but the arm between base and flange has: {', '.join(names)}"
        )
    return np.array([list(names).index(name) for name in wanted], dtype=np.int64)
