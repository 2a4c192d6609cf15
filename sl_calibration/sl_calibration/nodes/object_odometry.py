"""The tracked object as odometry on ~/object, for a node that has clouds."""

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Quaternion, Vector3
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.node import Node
from std_srvs.srv import Trigger

from sl_calibration.object_tracking import ObjectTracker, TrackingLostError
from sl_common import transforms
from sl_common.ros.qos import STREAM_PUBLISH
from sl_common.ros.stamps import to_ns

Array = NDArray[np.float64]


class ObjectTracking:
    """Publishes pose and velocity of the object since it was first seen.

    The object's frame has the axes of the base frame and its origin in the middle of the object at first sight.
    Covariances are those of the registration; a direction that the surface does not show carries 1 m^2.
    """

    def __init__(self, node: Node, base_frame: str) -> None:
        self._node, self._base_frame = node, base_frame
        self._tracker = ObjectTracker()
        self._origin: Array | None = None
        self._last: tuple[int, Array] | None = None
        self._publisher = node.create_publisher(Odometry, "~/object", STREAM_PUBLISH)
        node.create_service(Trigger, "~/reset_object", self._on_reset)

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._tracker.reset()
        self._origin = self._last = None
        response.success, response.message = True, "the object in the next cloud is followed"
        return response

    def update(self, stamp: Time, points: Array, row: NDArray[np.int64], col: NDArray[np.int64], eye: Array) -> None:
        """Track into a cloud (N, 3) of the base frame [m], seen from ``eye`` (3,), and publish; a loss is logged."""
        try:
            motion = self._tracker.update(points, row, col, eye)
        except TrackingLostError as error:
            self._node.get_logger().warning(f"object not tracked: {error}", throttle_duration_sec=5.0)
            self._last = None
            return
        if self._origin is None:
            self._origin = motion.centre
        pose = transforms.inverse(motion.reference_from_now) @ transforms.make(np.eye(3), self._origin)
        position, quaternion = transforms.to_quaternion(pose)
        message = Odometry(child_frame_id="object")
        message.header.stamp, message.header.frame_id = stamp, self._base_frame
        message.pose.pose.position = Point(x=position[0], y=position[1], z=position[2])
        x, y, z, w = quaternion
        message.pose.pose.orientation = Quaternion(x=x, y=y, z=z, w=w)
        message.pose.covariance = motion.covariance.ravel().tolist()
        now = to_ns(stamp)
        if self._last is not None and now > self._last[0]:
            seconds = 1e-9 * (now - self._last[0])
            # The twist of an odometry is given in the child frame.
            rate = transforms.difference(self._last[1], pose).reshape(2, 3) @ pose[:3, :3] / seconds
            message.twist.twist.linear = Vector3(x=rate[0, 0], y=rate[0, 1], z=rate[0, 2])
            message.twist.twist.angular = Vector3(x=rate[1, 0], y=rate[1, 1], z=rate[1, 2])
            turn = np.kron(np.eye(2), pose[:3, :3].T)
            message.twist.covariance = (turn @ (2 * motion.covariance / seconds**2) @ turn.T).ravel().tolist()
        else:
            message.twist.covariance = (1e6 * np.eye(6)).ravel().tolist()  # not known yet
        self._last = (now, pose)
        self._publisher.publish(message)
