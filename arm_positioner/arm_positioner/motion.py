"""The stream of setpoints with what lets it begin, what paces it, and whether the arm follows it."""

import numpy as np
from numpy.typing import NDArray

from arm_positioner import watchdog
from arm_positioner.limits import JointLimits
from arm_positioner.measured_arm import MeasuredArm
from arm_positioner.measurement import CommandHistory
from arm_positioner.pace import Pace
from arm_positioner.planning import require_regular_motion
from arm_positioner.starting import StreamStart
from arm_positioner.stream import SetpointStream
from arm_positioner.task import Outcome
from arm_positioner.trajectory import MotionState, Trajectory
from arm_positioner.watchdog import WatchOptions

Array = NDArray[np.float64]

_LOOK_AHEAD = 0.15
"""How far ahead on the trajectory the condition number is looked at [s]: about the time it takes to slow down."""


class Motion:
    """One arm's motion: from wherever it is measured at rest, by setpoints, to rest again.

    Attributes:
        stream: The setpoints.
        pace: The speed factor near singularities.
    """

    def __init__(self, arm: MeasuredArm, limits: JointLimits, period: float, options: WatchOptions) -> None:
        self._arm, self._options = arm, options
        self.stream = SetpointStream(limits, period)
        self.pace = Pace(options.thresholds, arm.conditioning.at)
        self._commands = CommandHistory(options.driver_lag)
        self._start = StreamStart(self.stream, arm.joints, self._commands, options)

    @property
    def has_settled(self) -> bool:
        """Whether the arm has been measured at rest after the last setpoint."""
        return self._start.settled is not None

    def begin(self, now: float) -> Array:
        """Make the stream ready to move and return the joint positions (n,) that it moves from.

        Raises StaleJointsError, NotAtRestError or JointLimitError.
        """
        self._start.ensure(now)
        assert self.stream.state is not None
        return self.stream.state.position

    def move(self, goal: Array, *, duration: float) -> Trajectory:
        """Head for rest at ``goal`` (n,), as a new motion at full speed."""
        trajectory = self.stream.move(goal, duration=duration)
        self.pace.restart()
        return trajectory

    def steer(self, goal: Array, *, duration: float) -> Trajectory:
        """Head for a goal (n,) that has moved, at the present pace."""
        return self.stream.move(goal, duration=duration, speed=self.pace.speed)

    def resume(self, goal: Array, *, duration: float, now: float) -> Trajectory:
        """Go on to ``goal`` (n,) after a halt; raises PositionerError where that is not possible any more."""
        self.begin(now)
        preview = self.stream.preview(goal, duration=duration)
        require_regular_motion(self._arm.conditioning, preview, self._options.thresholds)
        return self.move(goal, duration=duration)

    def advance(self, now: float) -> MotionState | None:
        """Return the setpoint of this control period; None at rest."""
        setpoint = self.stream.advance()
        if setpoint is not None:
            self._commands.add(now, setpoint.position)
            self._start.sent(now)
        if not self.stream.is_moving:
            self._start.settle()
        return setpoint

    def deviation(self) -> Outcome | None:
        """Compare the measured joints with the setpoints."""
        measured = self._arm.joints.newest
        if measured is None:
            return None
        off = self._commands.deviation(self._arm.joints.newest_time, measured)
        return watchdog.deviation(off, self.stream.limits.names, self._options)

    def look_ahead(self) -> tuple[float, bool]:
        """Return the condition number that the arm comes to, and whether it may be there."""
        ahead = self.stream.ahead(_LOOK_AHEAD)
        assert ahead is not None
        return self.pace.look(ahead.position)

    def change_pace(self, goal: Array, condition: float) -> bool:
        """Slow down or speed up for a condition number; returns whether the speed factor has changed.

        Raises PositionerError where no other motion can be planned: the present one goes on.
        """
        speed = self.pace.change(condition)
        if speed is None:
            return False
        duration = self.stream.remaining if speed < self.pace.speed else 0.0
        self.stream.move(goal, duration=duration, speed=speed)
        self.pace.speed = speed
        return True
