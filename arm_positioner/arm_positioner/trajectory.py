"""Jerk-limited trajectories on ruckig, checked against the position limits that ruckig's community version ignores."""

from dataclasses import dataclass

import numpy as np
import ruckig
from numpy.typing import ArrayLike, NDArray

from arm_positioner.errors import InvalidGoalError, JointLimitError
from arm_positioner.limits import JointLimits
from arm_positioner.stopping import stopping_range

Array = NDArray[np.float64]

_POSITION_TOLERANCE = 1e-9
_SOLVED = (ruckig.Result.Working, ruckig.Result.Finished)


@dataclass(frozen=True, eq=False)
class MotionState:
    """Position, velocity and acceleration (n,) of the joints at one instant [rad or m, and per s, s^2]."""

    position: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def at_rest(cls, position: ArrayLike) -> "MotionState":
        """Return the state that stands still at ``position`` (n,)."""
        q = np.array(position, dtype=np.float64)
        return cls(q, np.zeros_like(q), np.zeros_like(q))

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite."""
        return bool(np.isfinite([self.position, self.velocity, self.acceleration]).all())

    @property
    def is_at_rest(self) -> bool:
        """Whether velocity and acceleration are zero up to rounding."""
        return bool(np.abs(self.velocity).max() < 1e-9 and np.abs(self.acceleration).max() < 1e-9)


class Trajectory:
    """A motion that ends at rest.

    Attributes:
        duration: Time until rest [s].
        end: (n,) joint positions at rest.
    """

    def __init__(self, solution: ruckig.Trajectory) -> None:
        self._solution = solution
        self.duration: float = float(solution.duration)
        self.end: Array = np.array(solution.at_time(self.duration)[0])

    def at(self, time: float) -> MotionState:
        """Return the state at ``time`` [s] after the start; exactly at rest from ``duration`` on."""
        if time >= self.duration:
            return MotionState.at_rest(self.end)
        position, velocity, acceleration = self._solution.at_time(max(time, 0.0))
        return MotionState(np.array(position), np.array(velocity), np.array(acceleration))

    def sample(self, period: float) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations (N, n) every ``period`` [s] from the start to rest."""
        times = np.append(np.arange(0.0, self.duration, period), self.duration)
        states = [self._solution.at_time(t) for t in times.tolist()]
        p, v, a = (np.array([s[k] for s in states]) for k in range(3))
        return p, v, a


def plan(
    state: MotionState,
    goal: ArrayLike,
    limits: JointLimits,
    *,
    period: float,
    duration: float = 0.0,
    speed: float = 1.0,
) -> Trajectory:
    """Plan from any state to rest at ``goal``, joints synchronised, at any moment stoppable before a position limit.

    Args:
        state: Where the motion starts, moving or not.
        goal: (n,) joint positions [rad or m].
        limits: Limits to keep.
        period: Control period [s] at which the trajectory will be followed.
        duration: Least duration [s]; lengthened where the limits ask for more.
        speed: Factor on the velocity limits, in (0, 1]; a faster start is slowed down to it first.

    Raises:
        InvalidGoalError: A number is not finite or has the wrong size.
        JointLimitError: The goal or the way there is outside the position limits.
    """
    goal = np.asarray(goal, dtype=np.float64)
    if goal.shape != (limits.size,) or not np.isfinite(goal).all() or not np.isfinite(duration):
        raise InvalidGoalError(f"goal must be {limits.size} finite joint positions, got {goal.tolist()}")
    if reason := limits.outside(goal, _POSITION_TOLERANCE):
        raise JointLimitError(f"goal refused: {reason}")
    request = _request(state, limits)
    request.target_position = goal.tolist()
    request.max_velocity = (speed * limits.velocity).tolist()
    request.minimum_duration = duration if duration > 0 else None
    trajectory = Trajectory(_solve(request, limits.size))
    if reason := leaves_limits(trajectory, limits, period):
        raise JointLimitError(f"motion refused: {reason}; choose a goal further from the limit")
    return trajectory


def brake(state: MotionState, limits: JointLimits) -> Trajectory:
    """Plan the fastest stop from ``state``, each joint in its own shortest time.

    Raises InvalidGoalError where the state is not finite.
    """
    if not state.is_finite:
        raise InvalidGoalError("cannot plan a stop from a state that is not finite")
    request = _request(state, limits)
    request.control_interface = ruckig.ControlInterface.Velocity
    request.synchronization = ruckig.Synchronization.No
    request.target_velocity = [0.0] * limits.size
    return Trajectory(_solve(request, limits.size))


def leaves_limits(trajectory: Trajectory, limits: JointLimits, period: float) -> str:
    """Say which joint would leave its position limits on the trajectory, or when stopped on it; empty: none."""
    position, velocity, acceleration = trajectory.sample(period)
    low, high = stopping_range(position, velocity, acceleration, limits)
    low, high = np.minimum(low, position).min(axis=0), np.maximum(high, position).max(axis=0)
    return limits.outside(low, _POSITION_TOLERANCE) or limits.outside(high, _POSITION_TOLERANCE)


def _request(state: MotionState, limits: JointLimits) -> ruckig.InputParameter:
    request = ruckig.InputParameter(limits.size)
    request.current_position = state.position.tolist()
    request.current_velocity = state.velocity.tolist()
    request.current_acceleration = state.acceleration.tolist()
    request.max_velocity = limits.velocity.tolist()
    request.max_acceleration = limits.acceleration.tolist()
    request.max_jerk = limits.jerk.tolist()
    return request


def _solve(request: ruckig.InputParameter, size: int) -> ruckig.Trajectory:
    solution = ruckig.Trajectory(size)
    try:
        result = ruckig.Ruckig(size).calculate(request, solution)
    except ruckig.RuckigError as error:
        raise InvalidGoalError(f"no trajectory: {error}") from None
    if result not in _SOLVED:
        raise InvalidGoalError(f"no trajectory from {request.current_position} to {request.target_position}: {result}")
    return solution
