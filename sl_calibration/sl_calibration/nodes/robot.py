"""The robot's side of a node: flange poses at the stamps of images, from joint_states and robot_description."""

import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from sl_common.errors import InvalidInputError, StructuredLightError
from sl_common.joint_buffer import JointBuffer, JointLookupError, TooLate
from sl_common.kinematics import Kinematics
from sl_common.ros.qos import JOINT_STATES, LATCHED
from sl_common.ros.stamps import to_ns
from sl_common.ros.waiting import InputWatch

Array = NDArray[np.float64]
M = TypeVar("M")


class Robot:
    """Subscribes robot_description and joint_states and gives the flange pose at a stamp.

    Attributes:
        kinematics: From base to flange; None until robot_description came.
        joints: Joint positions by stamp.
    """

    def __init__(self, node: Node, watch: InputWatch, *, base_frame: str, flange_frame: str, max_gap: float) -> None:
        self._node, self._watch = node, watch
        self._base_frame, self._flange_frame = base_frame, flange_frame
        self.kinematics: Kinematics | None = None
        self.joints = JointBuffer(max_gap=max_gap)
        self.on_joints: Callable[[], None] = lambda: None
        watch.expect("robot_description", String, LATCHED)
        watch.expect("joint_states", JointState, JOINT_STATES)
        node.create_subscription(String, "robot_description", self._on_description, LATCHED)
        node.create_subscription(JointState, "joint_states", self._on_joint_state, JOINT_STATES)

    def pose_at(self, stamp: int) -> Array:
        """Return base_from_flange (4, 4) at ``stamp`` [ns].

        Raises InvalidInputError without a robot_description, JointLookupError where no joint positions can be had.
        """
        if self.kinematics is None:
            raise InvalidInputError("no robot_description received yet")
        return self.kinematics.forward(self.joints.at(stamp))

    def positions_at(self, stamp: int) -> Array:
        """Return the joint positions (n,) at ``stamp`` [ns]; raises as :meth:`pose_at`."""
        return self.joints.at(stamp)

    def _on_description(self, message: String) -> None:
        try:
            self.kinematics = Kinematics(message.data, self._base_frame, self._flange_frame)
        except StructuredLightError as error:
            self._node.get_logger().error(f"robot_description refused: {error}")
            return
        self.joints.clear()
        self._watch.seen("robot_description")

    def _on_joint_state(self, message: JointState) -> None:
        if self.kinematics is None:
            return
        try:
            positions = self.kinematics.positions_from(message.name, message.position)
            self.joints.add(to_ns(message.header.stamp), positions)
        except StructuredLightError as error:
            self._node.get_logger().warning(f"joint state refused: {error}", throttle_duration_sec=5.0)
            return
        self._watch.seen("joint_states")
        self.on_joints()


class Pairing(Generic[M]):
    """Holds messages until a joint state later than their stamp has come, for at most ``wait`` seconds."""

    def __init__(
        self,
        node: Node,
        robot: Robot,
        *,
        wait: float,
        deliver: Callable[[M, Array], None],
        refuse: Callable[[M, str], None],
        depth: int = 4,
    ) -> None:
        """``deliver`` gets a message and base_from_flange at its stamp, ``refuse`` a message and the reason."""
        self._robot, self._wait = robot, wait
        self._deliver, self._refuse = deliver, refuse
        self._pending: deque[tuple[float, int, M]] = deque(maxlen=depth)
        robot.on_joints = self.retry
        node.create_timer(max(wait / 4, 0.01), self.retry)

    def add(self, stamp: int, message: M) -> None:
        """Pair a message with the joint states around its ``stamp`` [ns], now or as soon as the later one comes."""
        self._pending.append((time.monotonic() + self._wait, stamp, message))
        self.retry()

    def retry(self) -> None:
        """Deliver what can be paired now and refuse what waited too long."""
        for _ in range(len(self._pending)):
            deadline, stamp, message = self._pending.popleft()
            try:
                pose = self._robot.pose_at(stamp)
            except TooLate as error:
                if time.monotonic() < deadline:
                    self._pending.append((deadline, stamp, message))
                else:
                    self._refuse(message, f"no joint state after the image within {self._wait:.2f} s: {error}")
            except (InvalidInputError, JointLookupError) as error:
                self._refuse(message, str(error))
            else:
                self._deliver(message, pose)
