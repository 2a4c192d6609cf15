"""The demo's eyes and ears: subscribes everything, keeps what the report needs, and records the bag."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
from std_msgs.msg import Float64MultiArray, String

from sl_bringup.bag.writer import BackgroundWriter
from sl_bringup.demo.record import Cloud, Record, pose_from_message
from sl_bringup.demo.truth import Truth, parse
from sl_common.ros import clouds
from sl_common.ros.qos import COMMANDS, JOINT_STATES, LATCHED, STREAM_SUBSCRIBE
from sl_common.ros.stamps import to_ns
from sl_msgs.action import PositionArm
from sl_msgs.msg import CalibrationProgress, Correspondences, Pattern, PositionerStatus

CELL = "cell"
DECODER = "decoder"
POSITIONER = "positioner"


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
