"""What can go wrong with a motion; each error carries the status code that reports it."""

from enum import IntEnum
from typing import Any, ClassVar

from sl_common.errors import StructuredLightError


class Code(IntEnum):
    """Codes of sl_msgs/msg/PositionerStatus; a test keeps both equal."""

    IDLE = 0
    MOVING = 1
    FOLLOWING = 2
    REACHED = 3
    PAUSED = 4
    STOPPED = 5
    STALE_JOINTS = 10
    STALE_TARGET = 11
    LOST_CLOUD = 12
    SINGULARITY = 13
    JOINT_LIMIT = 14
    UNREACHABLE = 15
    DRIVER_DEVIATION = 16
    INVALID_INPUT = 17


class PositionerError(StructuredLightError):
    """Base of the errors of this package.

    Attributes:
        code: Status code under which the node reports the error; subclasses name theirs in their definition.
    """

    code: ClassVar[Code] = Code.INVALID_INPUT

    def __init_subclass__(cls, *, code: Code | None = None, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if code is not None:
            cls.code = code


class InvalidGoalError(PositionerError):
    """A goal, target or parameter that cannot be used: not finite, in an unknown frame, of the wrong size."""


class TargetError(PositionerError, code=Code.LOST_CLOUD):
    """No target can be derived from a point cloud, or the surface fit is too poor to drive an arm by."""


class ObjectGoneError(TargetError):
    """The object seen before is not in the cloud any more."""


class JointLimitError(PositionerError, code=Code.JOINT_LIMIT):
    """A joint's position limit is in the way of a motion."""


class UnreachableError(PositionerError, code=Code.UNREACHABLE):
    """Inverse kinematics finds no joint positions for a pose."""


class SingularityError(PositionerError, code=Code.SINGULARITY):
    """A motion would lead into or through a singularity."""


class StaleJointsError(PositionerError, code=Code.STALE_JOINTS):
    """No joint state, or too old a one, to start a motion from."""


class StaleTargetError(PositionerError, code=Code.STALE_TARGET):
    """A target whose stamp is too old to act on."""


class NotAtRestError(PositionerError, code=Code.DRIVER_DEVIATION):
    """The arm still moves by itself: a stream of setpoints cannot start from there without a jump."""


class PausedError(PositionerError, code=Code.PAUSED):
    """Nothing moves while the arm is paused or the node shuts down."""


class SupersededError(PositionerError, code=Code.STOPPED):
    """A newer order, or a stop, came before this one could begin."""
