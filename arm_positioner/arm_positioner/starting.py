"""Where a stream of setpoints begins: it goes on from its last setpoint, or anew where the arm is measured at rest."""

import numpy as np
from numpy.typing import NDArray

from arm_positioner import watchdog
from arm_positioner.errors import NotAtRestError, StaleJointsError
from arm_positioner.measurement import CommandHistory, MeasuredJoints
from arm_positioner.stream import SetpointStream
from arm_positioner.watchdog import WatchOptions

Array = NDArray[np.float64]


class StreamStart:
    """Remembers how the last motion ended and lets the next one begin without a jump.

    Attributes:
        settled: (n,) measured joints once the last motion had come to rest; None: not yet.
    """

    def __init__(
        self, stream: SetpointStream, measured: MeasuredJoints, commands: CommandHistory, options: WatchOptions
    ) -> None:
        self._stream, self._measured, self._commands, self._options = stream, measured, commands, options
        self.settled: Array | None = None
        self._last_setpoint: float | None = None

    def sent(self, now: float) -> None:
        """Note that a setpoint has left."""
        self._last_setpoint, self.settled = now, None

    def settle(self) -> None:
        """Note where the arm rests once it does."""
        if self.settled is None and self._last_setpoint is not None:
            self.settled = self._measured.rest_position(since=self._last_setpoint)

    def ensure(self, now: float) -> None:
        """Let the stream continue its last setpoint, or start from the measured joints where there is none.

        Raises StaleJointsError, NotAtRestError or JointLimitError; nothing has changed then.
        """
        if stale := watchdog.stale_joints(now - self._measured.newest_time, self._options):
            raise StaleJointsError(f"refused: {stale.message}; check joint_states")
        if self._stream.is_moving or (self.settled is None and self._is_settling(now)):
            return
        position = self._measured.rest_position()
        if position is None:
            raise NotAtRestError(self._motion())
        if self._stream.fault or not self._is_untouched(position):
            self._stream.start(position)
            self._commands.clear()
            self._commands.add(now, position)

    def _motion(self) -> str:
        motion = self._measured.motion()
        if motion is None:
            return "refused: too few joint states yet to tell whether the arm is at rest"
        i = int(np.argmax(motion))
        return (
            f"refused: joint {self._stream.limits.names[i]} moved by {motion[i]:.4f} within 0.1 s, limit "
            f"{self._options.rest_motion:g}; wait until the arm is at rest"
        )

    def _is_settling(self, now: float) -> bool:
        """Whether the last setpoint left so recently that the arm may still be on its way there."""
        return self._last_setpoint is not None and now - self._last_setpoint < self._options.driver_lag

    def _is_untouched(self, position: Array) -> bool:
        """Whether the arm still stands where the last motion left it, or nearer to the last setpoint."""
        if self._stream.state is None or self.settled is None:
            return False
        commanded = self._stream.state.position
        moved = np.abs(position - self.settled)
        nearer = np.abs(position - commanded) <= np.abs(self.settled - commanded)
        follows = np.abs(position - commanded) <= self._options.deviation
        return bool((((moved <= self._options.drift) | nearer) & follows).all())
