"""Joint states into the supervisor and the scene."""

import time
from collections.abc import Callable

from rclpy.node import Node
from sensor_msgs.msg import JointState

from arm_positioner.errors import InvalidGoalError
from arm_positioner.ros.complaints import Complaints
from arm_positioner.ros.polled import PolledSubscription
from arm_positioner.ros.scene import Scene
from arm_positioner.supervisor import Supervisor
from sl_common.ros.diagnostics import Diagnostics
from sl_common.ros.qos import JOINT_STATES
from sl_common.ros.stamps import to_ns

TOPIC = "joint_states"


class JointInput:
    """Takes the joint states that have arrived, in the thread that sends setpoints."""

    def __init__(
        self, node: Node, scene: Scene, complaints: Complaints, diagnostics: Diagnostics, seen: Callable[[str], None]
    ) -> None:
        """Tell ``seen`` of the topic when a usable state has come."""
        self._node, self._scene, self._complaints, self._diagnostics = node, scene, complaints, diagnostics
        self._seen = seen
        self._subscription = PolledSubscription(node, JointState, TOPIC, JOINT_STATES)

    def take(self, supervisor: Supervisor, *, tolerance: float) -> None:
        """Hand over all states that have come; one stamped more than ``tolerance`` [s] in the future is not used.

        A state that cannot be used is named and left out, whatever is wrong with it: the stream of setpoints goes on,
        and the watch stops the arm when no usable one comes any more.
        """
        for message in self._subscription.take():
            try:
                self._use(supervisor, message, tolerance)
            except Exception as error:  # nothing in a message may end the thread that sends setpoints
                self._complaints.warn(f"{TOPIC} not used: {error}")
                self._diagnostics.set(TOPIC, str(error))

    def _use(self, supervisor: Supervisor, message: JointState, tolerance: float) -> None:
        positions = supervisor.positions_from(message.name, message.position)
        stamp = to_ns(message.header.stamp)
        age = 1e-9 * (self._node.get_clock().now().nanoseconds - stamp)
        if age < -tolerance:
            raise InvalidGoalError(f"joint state is stamped {-age:.3f} s in the future: synchronise the clocks")
        self._scene.add_joints(stamp, positions)
        supervisor.joint_state(time.monotonic() - max(age, 0.0), positions)
        self._seen(TOPIC)
        self._diagnostics.tick(TOPIC)
