"""Sending setpoints: forward_position sends each one, joint_trajectory a short look-ahead that ends at rest."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from arm_positioner.trajectory import MotionState
from sl_common.ros.qos import COMMANDS
from sl_common.ros.stamps import from_ns

_SECOND = 1_000_000_000


class Commands(Protocol):
    """A way to send setpoints to a driver."""

    def periods(self, *, moving: bool) -> int:
        """Return by how many control periods to advance now."""

    def send(self, setpoint: MotionState, motion_id: int) -> None:
        """Send the setpoint of this control period; ``motion_id`` tells whether the plan has changed since the last."""


class ForwardPosition:
    """std_msgs/Float64MultiArray on ``commands``, one a period, for forward_command_controller."""

    def __init__(self, node: Node, order: NDArray[np.int64]) -> None:
        """Send joint ``order[i]`` of the arm as the i-th number."""
        self._publisher = node.create_publisher(Float64MultiArray, "commands", COMMANDS)
        self._order = order

    def periods(self, *, moving: bool) -> int:
        """Return 1: the driver takes one setpoint after the other, late or not."""
        return 1

    def send(self, setpoint: MotionState, motion_id: int) -> None:
        """Publish the positions."""
        self._publisher.publish(Float64MultiArray(data=setpoint.position[self._order].tolist()))


class Trajectories:
    """trajectory_msgs/JointTrajectory on ``joint_trajectory``, for joint_trajectory_controller.

    Each message holds the setpoints of the next ``lookahead`` seconds, one per control period, and then the stop from
    there: its last point is at rest, as the controller asks for, and where no further message comes (the node was
    killed) the arm comes to rest within the limits. A new message leaves when the plan changes and every quarter of
    the look-ahead; its points lie on the same time grid as before, so that replacing one by the next changes nothing
    where both agree.
    """

    def __init__(
        self,
        node: Node,
        names: Sequence[str],
        order: NDArray[np.int64],
        period: float,
        lookahead: float,
        outlook: Callable[[float], list[MotionState]],
    ) -> None:
        """Send ``names`` (in the order of the command); ``outlook`` returns the setpoints to come."""
        self._node, self._names, self._order = node, list(names), order
        self._lookahead, self._outlook = lookahead, outlook
        self._publisher = node.create_publisher(JointTrajectory, "joint_trajectory", COMMANDS)
        self._every = max(int(0.25 * lookahead / period), 1)
        self._motion_id = -1
        self._since = 0
        self._step = round(period * _SECOND)
        self._horizon = round(lookahead / period)
        self._origin = 0  # ROS time of the last setpoint [ns]

    def periods(self, *, moving: bool) -> int:
        """Return the periods since the last setpoint: the driver follows stamps, so lost time is made up for."""
        now = self._node.get_clock().now().nanoseconds
        periods = round((now - self._origin) / self._step)
        if not moving or not 0 <= periods <= self._horizon:  # a new motion, or the clock was set
            self._origin = now - self._step
            return 1
        return periods

    def send(self, setpoint: MotionState, motion_id: int) -> None:
        """Publish if the plan has changed or the look-ahead is a quarter used up."""
        self._origin += self._step
        self._since += 1
        if motion_id == self._motion_id and self._since < self._every:
            return
        self._motion_id, self._since = motion_id, 0
        message = JointTrajectory(joint_names=self._names)
        message.header.stamp = from_ns(self._origin)
        message.points = [
            self._point(state, k * self._step) for k, state in enumerate([setpoint, *self._outlook(self._lookahead)])
        ]
        self._publisher.publish(message)

    def _point(self, state: MotionState, offset: int) -> JointTrajectoryPoint:
        point = JointTrajectoryPoint(
            positions=state.position[self._order].tolist(),
            velocities=state.velocity[self._order].tolist(),
            accelerations=state.acceleration[self._order].tolist(),
        )
        point.time_from_start.sec, point.time_from_start.nanosec = divmod(offset, _SECOND)
        return point
