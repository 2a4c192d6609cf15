"""What can go wrong with a motion; each error carries the status code that reports it."""

from enum import IntEnum

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
        code: Status code under which the node reports the error.
    """

    code = Code.INVALID_INPUT


class InvalidGoalError(PositionerError):
    """A goal, target or parameter that cannot be used: not finite, in an unknown frame, of the wrong size."""


class TargetError(PositionerError):
    """No target can be derived from a point cloud, or the surface fit is too poor to drive an arm by."""

    code = Code.LOST_CLOUD


class JointLimitError(PositionerError):
    """A joint's position limit is in the way of a motion."""

    code = Code.JOINT_LIMIT


class UnreachableError(PositionerError):
    """Inverse kinematics finds no joint positions for a pose."""

    code = Code.UNREACHABLE


class SingularityError(PositionerError):
    """A motion would lead into or through a singularity."""

    code = Code.SINGULARITY


class StaleJointsError(PositionerError):
    """No joint state, or too old a one, to start a motion from."""

    code = Code.STALE_JOINTS


class StaleTargetError(PositionerError):
    """A target whose stamp is too old to act on."""

    code = Code.STALE_TARGET


class NotAtRestError(PositionerError):
    """The arm still moves by itself: a stream of setpoints cannot start from there without a jump."""

    code = Code.DRIVER_DEVIATION


class PausedError(PositionerError):
    """Nothing moves while the arm is paused or the node shuts down."""

    code = Code.PAUSED
