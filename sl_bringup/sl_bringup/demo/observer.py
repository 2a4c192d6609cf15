"""The demo's eyes and ears: subscribes everything, keeps what the report needs, and records the bag."""

import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
from std_msgs.msg import Float64MultiArray, String

from sl_bringup.bag.writer import BackgroundWriter
from sl_bringup.demo.truth import Truth, parse
from sl_common import transforms
from sl_common.ros import clouds
from sl_common.ros.qos import COMMANDS, JOINT_STATES, LATCHED, STREAM_SUBSCRIBE
from sl_common.ros.stamps import to_ns
from sl_msgs.action import PositionArm
from sl_msgs.msg import CalibrationProgress, Correspondences, Pattern, PositionerStatus

Array = NDArray[np.float64]

CELL = "cell"
DECODER = "decoder"
POSITIONER = "positioner"


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


class Observer(Node):
    """Subscribes the chain's topics.

    Attributes:
        record: Everything kept.
        latest: Newest message by topic.
        truth: Newest truth of the cell, for the report.
    """

    def __init__(self, bag: BackgroundWriter | None = None, *, image_period: float = 1.0) -> None:
        """Subscribe; ``bag`` gets every message, images at most every ``image_period`` [s]."""
        super().__init__("demo")
        self.record = Record()
        self.latest: dict[str, Any] = {}
        self.truth: Truth | None = None
        self._bag, self._image_period = bag, image_period
        self._last_image: dict[str, float] = {}
        self._debug: Any = None
        self._listen(Pattern, "pattern", LATCHED)
        self._listen(CameraInfo, "projector/camera_info", LATCHED)
        self._listen(Image, "projector/image", LATCHED)
        self._listen(String, "robot_description", LATCHED)
        self._listen(Image, "camera/image_raw", STREAM_SUBSCRIBE, self._on_image)
        self._listen(CameraInfo, "camera/camera_info", STREAM_SUBSCRIBE)
        self._listen(JointState, "joint_states", JOINT_STATES, self._on_joints)
        self._listen(Float64MultiArray, "commands", COMMANDS, self._on_command)
        self._listen(Correspondences, "correspondences", STREAM_SUBSCRIBE, self._on_correspondences)
        self._listen(PointCloud2, "points", STREAM_SUBSCRIBE, self._on_points)
        self._listen(PositionerStatus, f"{POSITIONER}/status", COMMANDS, self._on_status)
        self._listen(PoseStamped, f"{POSITIONER}/target", COMMANDS)
        self._listen(DiagnosticArray, "/diagnostics", COMMANDS)
        self._listen(CalibrationProgress, "calibrator/progress", LATCHED)
        self._listen(String, f"{CELL}/truth", LATCHED, self._on_truth)
        self._listen(PoseStamped, f"{CELL}/truth/camera_pose", COMMANDS, self._on_camera_pose)
        self._listen(PoseStamped, f"{CELL}/truth/object_pose", COMMANDS, self._on_object_pose)
        self.position_arm = ActionClient(self, PositionArm, f"{POSITIONER}/position_arm")

    def watch_debug_image(self, on: bool) -> None:
        """Subscribe the decoder's debug image, which it draws only while somebody looks."""
        if on and self._debug is None:
            self._debug = self._listen(Image, f"{DECODER}/debug_image", STREAM_SUBSCRIBE)
        elif not on and self._debug is not None:
            self.destroy_subscription(self._debug)
            self._debug = None

    def _listen(self, kind: type, topic: str, qos: QoSProfile, callback: Callable[[Any], None] | None = None) -> Any:
        def receive(message: Any) -> None:
            self.record.arrivals[topic].append(time.monotonic())
            self.latest[topic] = message
            if callback is not None:
                callback(message)
            self._to_bag(topic, message, latched=qos is LATCHED)

        return self.create_subscription(kind, topic, receive, qos)

    def _to_bag(self, topic: str, message: Any, *, latched: bool) -> None:
        if self._bag is None:
            return
        if isinstance(message, Image) and not latched:
            now = time.monotonic()
            if now - self._last_image.get(topic, -np.inf) < self._image_period:
                return
            self._last_image[topic] = now
        name = topic if topic.startswith("/") else f"/{topic}"
        self._bag.write(name, message, self.get_clock().now().nanoseconds, latched=latched)

    def _delay(self, topic: str, message: Any) -> None:
        self.record.latencies[topic].append((self.get_clock().now().nanoseconds - to_ns(message.header.stamp)) * 1e-9)

    def _on_image(self, message: Image) -> None:
        self._delay("camera/image_raw", message)

    def _on_joints(self, message: JointState) -> None:
        self.record.joint_names = tuple(message.name)
        self.record.joints.append((to_ns(message.header.stamp), np.array(message.position)))

    def _on_command(self, message: Float64MultiArray) -> None:
        self.record.commands.append((self.get_clock().now().nanoseconds, np.array(message.data)))

    def _on_correspondences(self, message: Correspondences) -> None:
        self._delay("correspondences", message)
        stamp = to_ns(message.header.stamp)
        self.record.dots.append((stamp, len(message.row)))
        self.record.decode_times.append(message.decode_time)
        kept = self.record.correspondences
        if not kept or stamp - to_ns(kept[-1].header.stamp) >= 500_000_000:
            kept.append(message)

    def _on_points(self, message: PointCloud2) -> None:
        self._delay("points", message)
        fields = clouds.from_message(message)
        points = np.stack([fields["x"], fields["y"], fields["z"]], axis=-1).astype(np.float64)
        row, col = fields["row"].astype(np.int64), fields["col"].astype(np.int64)
        self.record.clouds.append(Cloud(to_ns(message.header.stamp), row, col, points))

    def _on_status(self, message: PositionerStatus) -> None:
        statuses = self.record.statuses
        if not statuses or statuses[-1][1] != message.code:
            statuses.append((time.monotonic(), message.code, message.message))

    def _on_truth(self, message: String) -> None:
        self.truth = parse(message.data)

    def _on_camera_pose(self, message: PoseStamped) -> None:
        self.record.camera_poses[to_ns(message.header.stamp)] = pose_from_message(message)

    def _on_object_pose(self, message: PoseStamped) -> None:
        self.record.object_poses[to_ns(message.header.stamp)] = pose_from_message(message)


def pose_from_message(message: PoseStamped) -> Array:
    """Return the pose (4, 4) [m] of a message."""
    p, q = message.pose.position, message.pose.orientation
    return transforms.from_quaternion((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))
