"""The quality-of-service profiles of the stack (REP-2003): publish reliable, subscribe to streams best effort."""

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

LATCHED = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Pattern, projector image and camera_info, robot_description: a late subscriber gets the last one."""

STREAM_PUBLISH = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.RELIABLE)
"""Images, correspondences, clouds, for publishers: matches subscribers of either kind."""

STREAM_SUBSCRIBE = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Images, correspondences, clouds, for subscribers: the newest only, never a queue of old ones."""

JOINT_STATES = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Joint states for subscribers: all of a burst, to interpolate between."""

COMMANDS = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""Setpoints and status."""


def describe(profile: QoSProfile) -> str:
    """Return a profile in words, for messages to the user."""
    latched = ", transient local" if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL else ""
    reliability = "best effort" if profile.reliability == ReliabilityPolicy.BEST_EFFORT else "reliable"
    return f"{reliability}{latched}, depth {profile.depth}"
