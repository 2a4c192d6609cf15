"""The stream of setpoints: one per control period, continuous whatever is asked of it."""

from numpy.typing import ArrayLike

from arm_positioner.errors import JointLimitError, PositionerError
from arm_positioner.guard import SetpointGuard
from arm_positioner.limits import JointLimits
from arm_positioner.trajectory import MotionState, Trajectory, brake, plan

_PLANNING_SHARE = 0.999
"""Share of the velocity, acceleration and jerk limits that plans use, so that rounding never crosses a limit."""


class SetpointStream:
    """Follows one trajectory at a time and replaces it from the state that was last commanded.

    Every trajectory it follows ends at rest and stays stoppable inside the limits, so whatever happens next, including
    nothing at all, is safe. A setpoint that the guard refuses never leaves: the stream brakes from the last good one.

    Attributes:
        limits: The limits that setpoints keep.
        period: Control period [s].
        fault: Why the guard refused a setpoint; empty: it never did since the last start.
        motion_id: Changes whenever another trajectory is followed.
    """

    def __init__(self, limits: JointLimits, period: float) -> None:
        self.limits = limits
        self.period = period
        self.fault = ""
        self._planning = limits.scaled(velocity=_PLANNING_SHARE, acceleration=_PLANNING_SHARE, jerk=_PLANNING_SHARE)
        self._guard = SetpointGuard(limits, period)
        self._state: MotionState | None = None
        self._trajectory: Trajectory | None = None
        self._tick = 0
        self._announced = False
        self.motion_id = 0

    @property
    def state(self) -> MotionState | None:
        """The last commanded state; None before the first start."""
        return self._state

    @property
    def is_moving(self) -> bool:
        """Whether setpoints of a trajectory are still to come."""
        return self._trajectory is not None

    @property
    def end(self) -> MotionState | None:
        """Where the stream will be at rest; None before the first start."""
        if self._trajectory is not None:
            return MotionState.at_rest(self._trajectory.end)
        return self._state

    @property
    def remaining(self) -> float:
        """Time until rest [s]."""
        if self._trajectory is None:
            return 0.0
        return max(self._trajectory.duration - self._tick * self.period, 0.0)

    def start(self, position: ArrayLike) -> None:
        """Begin at rest at the measured joint positions (n,).

        Raises JointLimitError where they are outside the limits: nothing may move then, and PositionerError while the
        stream still moves.
        """
        if self.is_moving:
            raise PositionerError("a stream that moves cannot be started anew; stop it first")
        state = MotionState.at_rest(position)
        if reason := self.limits.outside(state.position):
            raise JointLimitError(f"cannot start: {reason}; bring the joint back by the robot's own controls")
        self._state, self._trajectory, self.fault = state, None, ""
        self._announced = False
        self._guard.reset(state.position)

    def preview(self, goal: ArrayLike, *, duration: float = 0.0, speed: float = 1.0) -> Trajectory:
        """Return what :meth:`move` would follow, without doing so."""
        return plan(self._started(), goal, self._planning, period=self.period, duration=duration, speed=speed)

    def move(self, goal: ArrayLike, *, duration: float = 0.0, speed: float = 1.0) -> Trajectory:
        """Head for rest at ``goal`` (n,) from the present state; see :func:`arm_positioner.trajectory.plan`.

        On an error the present trajectory goes on.
        """
        trajectory = self.preview(goal, duration=duration, speed=speed)
        self._follow(trajectory)
        return trajectory

    def stop(self) -> None:
        """Come to rest as fast as the limits allow; nothing to do before the first start."""
        if self._state is not None and self.is_moving:
            self._follow(brake(self._state, self._planning))

    def advance(self) -> MotionState | None:
        """Return the setpoint of the next control period; None at rest."""
        if self._trajectory is None or self._state is None:
            return None
        state = self._next()
        if reason := self._guard.violation(state):
            first, self.fault = not self.fault, reason
            if not first:  # even the stop is refused: send nothing more, the driver holds the last setpoint
                self._trajectory = None
                return None
            self._follow(brake(self._state, self._planning))
            state = self._next()
            if reason := self._guard.violation(state):
                self._trajectory = None
                return None
        self._guard.accept(state)
        self._state, self._announced = state, True
        if self._trajectory is not None and self._tick * self.period >= self._trajectory.duration:
            self._trajectory = None
        return state

    def ahead(self, time: float) -> MotionState | None:
        """Return the state ``time`` [s] from now on the present trajectory; None before the first start."""
        if self._trajectory is None:
            return self._state
        return self._trajectory.at(self._tick * self.period + time)

    def outlook(self, horizon: float) -> list[MotionState]:
        """Return the setpoints to come, one per period.

        They follow the present trajectory for ``horizon`` [s] and then stop from there: whoever executes them and hears
        nothing more comes to rest within the limits. Empty at rest.
        """
        if self._trajectory is None:
            return []
        states: list[MotionState] = []
        trajectory, tick = self._trajectory, self._tick
        while tick * self.period < trajectory.duration:
            tick += 1
            states.append(trajectory.at(tick * self.period))
            if trajectory is self._trajectory and len(states) * self.period >= horizon and not states[-1].is_at_rest:
                trajectory, tick = brake(states[-1], self._planning), 0
        return states

    def _next(self) -> MotionState:
        assert self._trajectory is not None
        self._tick += 1
        return self._trajectory.at(self._tick * self.period)

    def _follow(self, trajectory: Trajectory) -> None:
        # the first setpoint after a start is the start itself: whoever hears it has something to continue from
        self._trajectory, self._tick = trajectory, 0 if self._announced else -1
        self.motion_id += 1

    def _started(self) -> MotionState:
        if self._state is None:
            raise PositionerError("the stream has not started: no measured joint positions yet")
        return self._state
