"""What a run of the demo leaves for its report."""

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray

from sl_common import transforms
from sl_msgs.msg import Correspondences

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Cloud:
    """A point cloud in the base frame with the stamp of its image [ns]."""

    stamp: int
    row: NDArray[np.int64]
    col: NDArray[np.int64]
    points: Array


@dataclass
class Record:
    """What was seen, in order of arrival.

    Attributes:
        arrivals: Times of arrival [s, monotonic] by topic.
        latencies: Arrival minus stamp of the source image [s] by topic.
        joint_names: Order of the joint states.
        joints: Stamp [ns] and positions (n,) of joint states.
        commands: Time of arrival [ns] and positions (n,) of setpoints.
        camera_poses: True base_from_camera by stamp [ns].
        object_poses: True base_from_object by stamp [ns].
        clouds: All clouds.
        correspondences: The newest of each second, and the newest.
        dots: Number of dots decoded by stamp [ns].
        decode_times: [s].
        statuses: Changes of the positioner's status: time [s, monotonic], code, message.
    """

    arrivals: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    latencies: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    joint_names: tuple[str, ...] = ()
    joints: list[tuple[int, Array]] = field(default_factory=list)
    commands: list[tuple[int, Array]] = field(default_factory=list)
    camera_poses: dict[int, Array] = field(default_factory=dict)
    object_poses: dict[int, Array] = field(default_factory=dict)
    clouds: list[Cloud] = field(default_factory=list)
    correspondences: list[Correspondences] = field(default_factory=list)
    dots: list[tuple[int, int]] = field(default_factory=list)
    decode_times: list[float] = field(default_factory=list)
    statuses: list[tuple[float, int, str]] = field(default_factory=list)

    def rate(self, topic: str) -> float:
        """Return the mean rate of a topic over all of its messages [1/s]; 0 with fewer than two."""
        times = self.arrivals.get(topic, [])
        return (len(times) - 1) / (times[-1] - times[0]) if len(times) > 1 else 0.0


def pose_from_message(message: PoseStamped) -> Array:
    """Return the pose (4, 4) [m] of a message."""
    p, q = message.pose.position, message.pose.orientation
    return transforms.from_quaternion((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
