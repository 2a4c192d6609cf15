"""Node positioner: brings the camera in front of the object, or to a pose, within the limits of the arm."""

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from visualization_msgs.msg import MarkerArray

from arm_positioner import limits
from arm_positioner.errors import Code, InvalidGoalError, PositionerError, StaleTargetError
from arm_positioner.hand_eye import HandEye
from arm_positioner.planning import Planner
from arm_positioner.ros import parameters
from arm_positioner.ros.action import PositionArmServer
from arm_positioner.ros.commands import Commands, ForwardPosition, Trajectories
from arm_positioner.ros.complaints import Complaints
from arm_positioner.ros.conversions import markers, stamped
from arm_positioner.ros.joints import JointInput
from arm_positioner.ros.scene import Scene
from arm_positioner.servo import ServoGate
from arm_positioner.setpoint_loop import SetpointLoop, raise_priority
from arm_positioner.supervisor import Supervisor
from arm_positioner.task import Kind
from sl_common.errors import StructuredLightError
from sl_common.kinematics import Kinematics
from sl_common.ros.diagnostics import ERROR, OK, WARN, Diagnostics
from sl_common.ros.qos import COMMANDS, JOINT_STATES, LATCHED, STREAM_SUBSCRIBE
from sl_common.ros.run import run_node
from sl_common.ros.stamps import from_ns, to_ns
from sl_common.ros.waiting import InputWatch
from sl_msgs.msg import PositionerStatus

_CLOSING_TIME = 5.0
"""Longest wait for the arm to come to rest when the node ends [s]."""


class PositionerNode(Node):
    """Converts messages and owns the thread that sends setpoints; everything else is in the modules it imports."""

    def __init__(self) -> None:
        super().__init__("positioner")
        self._settings = s = parameters.read(self)
        self._hand_eye = HandEye(s.calibration_folder)
        self._supervisor: Supervisor | None = None
        self._loop: SetpointLoop | None = None
        self._commands: Commands | None = None
        self._gate = ServoGate()
        self._complaints = Complaints(self)
        self._reported: Code | None = None
        self._scene = Scene(self, s, self._hand_eye, self._complaints)
        self._action = PositionArmServer(self, s, self._scene, self._supervisor_for_goal)
        self._status = self.create_publisher(PositionerStatus, "~/status", COMMANDS)
        self._target = self.create_publisher(PoseStamped, "~/target", COMMANDS)
        self._markers = self.create_publisher(MarkerArray, "~/markers", COMMANDS)
        self._diagnostics = Diagnostics(self)
        self._watch = InputWatch(self)
        self._subscribe(String, "robot_description", self._on_description, LATCHED)
        self._joints = JointInput(self, self._scene, self._complaints, self._diagnostics, self._watch.seen)
        self._watch.expect("joint_states", JointState, JOINT_STATES)
        self._subscribe(PointCloud2, "points", self._on_cloud, STREAM_SUBSCRIBE)
        group = ReentrantCallbackGroup()
        self.create_subscription(
            PoseStamped,
            "~/target_pose",
            self._on_target,
            STREAM_SUBSCRIBE,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        self.create_service(SetBool, "~/pause", self._on_pause, callback_group=group)
        self.create_service(Trigger, "~/stop", self._on_stop, callback_group=group)
        self.create_timer(0.1, self._publish_status, callback_group=MutuallyExclusiveCallbackGroup())
        self.create_timer(1.0, self._check_files, callback_group=MutuallyExclusiveCallbackGroup())
        if self._hand_eye.problem:
            self.get_logger().warning(
                f"{self._hand_eye.problem}; until then camera poses are poses of {s.flange_frame}"
            )

    def _subscribe(self, kind: Any, topic: str, callback: Callable[[Any], None], qos: QoSProfile) -> None:
        self.create_subscription(kind, topic, callback, qos, callback_group=MutuallyExclusiveCallbackGroup())
        self._watch.expect(topic, kind, qos)

    def _require_supervisor(self) -> Supervisor:
        if self._supervisor is None:
            raise InvalidGoalError("refused: no robot_description received yet")
        return self._supervisor

    def _supervisor_for_goal(self) -> Supervisor:
        """The supervisor, with the calibration that has just been saved."""
        self._read_calibration()
        return self._require_supervisor()

    def _read_calibration(self) -> None:
        supervisor = self._supervisor
        if news := self._hand_eye.refresh():
            self.get_logger().info(news)
        if supervisor is not None and supervisor.task is None:
            supervisor.flange_from_camera = self._hand_eye.flange_from_camera

    def _on_description(self, message: String) -> None:
        """Build everything that needs the arm, once."""
        if self._supervisor is not None:
            return
        s = self._settings
        try:
            arms = [Kinematics(message.data, s.base_frame, s.flange_frame) for _ in range(3)]
            arm, joint_limits = arms[0], parameters.joint_limits(arms[0], s)
            order = limits.command_order(arm.joint_names, s.joints)
        except StructuredLightError as error:
            self.get_logger().error(f"robot_description not used: {error}")
            self._diagnostics.level(ERROR, str(error))
            return
        self._watch.seen("robot_description")
        planner = Planner(arms[1], joint_limits, margin=s.joint_margin, thresholds=s.watch.thresholds)
        supervisor = Supervisor(arm, planner, joint_limits, period=s.period, options=s.watch)
        supervisor.flange_from_camera = self._hand_eye.flange_from_camera
        if s.command_interface == parameters.FORWARD_POSITION:
            self._commands = ForwardPosition(self, order)
        else:
            names = [arm.joint_names[i] for i in order]
            self._commands = Trajectories(self, names, order, s.period, s.lookahead, supervisor.outlook)
        self._scene.attach(arms[2], supervisor)
        self._supervisor = supervisor
        self._loop = SetpointLoop(s.period, self._tick)
        self._loop.start()
        self.get_logger().info(
            f"arm with joints {', '.join(arm.joint_names)}; {s.command_interface} at {1 / s.period:g}/s"
        )

    def _tick(self) -> None:
        """One control period, in the setpoint thread."""
        supervisor, commands = self._require_supervisor(), self._commands
        assert commands is not None
        self._joints.take(supervisor, tolerance=self._settings.watch.joint_timeout)
        for _ in range(commands.periods(moving=supervisor.is_moving)):
            setpoint = supervisor.tick()
            if setpoint is not None:
                commands.send(setpoint, supervisor.motion_id)
                self._diagnostics.tick("setpoints")
        if supervisor.code is not self._reported:
            if supervisor.code >= Code.STALE_JOINTS or supervisor.code is Code.STOPPED:
                self._gate.close()
            self._publish_status()

    def _on_cloud(self, message: PointCloud2) -> None:
        self._watch.seen("points")
        self._diagnostics.tick("points")
        self._scene.add_cloud(message)

    def _on_target(self, message: PoseStamped) -> None:
        """Follow a stream of targets; one that is too old, or of a stream that was stopped, does nothing."""
        now, limit = time.monotonic(), self._settings.watch.target_timeout
        try:
            supervisor = self._require_supervisor()
            age = 1e-9 * (self.get_clock().now().nanoseconds - to_ns(message.header.stamp))
            if abs(age) > limit:
                raise StaleTargetError(f"stamped {age:.3f} s ago, limit {limit:g} s")
            if not self._gate.admits(now):
                raise InvalidGoalError("its stream was stopped; pause it for a second or resume by ~/pause")
            target = self._scene.base_from_goal(message)
            task = supervisor.task
            if task is not None and task.kind is Kind.SERVO:
                supervisor.retarget(task, target)
            elif task is not None:
                raise InvalidGoalError("a goal of ~/position_arm is running")
            else:
                self._gate.close()  # until this succeeds
                self._scene.reset()
                supervisor.begin(Kind.SERVO, target)
                self._gate.open()
        except StructuredLightError as error:
            self._complaints.warn(f"~/target_pose not used: {error}")

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        try:
            response.message = self._require_supervisor().pause(paused=request.data)
            response.success = True
            if not request.data:
                self._gate.open()
        except PositionerError as error:
            response.message = str(error)
        return response

    def _on_stop(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message = self._require_supervisor().stop()
            response.success = True
            self._gate.close()
        except PositionerError as error:
            response.message = str(error)
        return response

    def _check_files(self) -> None:
        self._read_calibration()
        if self._loop is not None:
            for key, value in self._loop.jitter().items():
                self._diagnostics.set(f"setpoint {key}", value)
            if self._loop.failure is not None:
                self.get_logger().error(f"setpoints have ended: {self._loop.failure!r}; restart the node")
                if self._supervisor is not None:
                    self._supervisor.fail("setpoints have ended by a defect; restart the node")
        if self._scene.seen is not None:
            sigma = np.degrees(self._scene.seen.surface.normal_sigma)
            self._diagnostics.set("surface normal known to [deg]", f"{sigma:.2f}")

    def _publish_status(self) -> None:
        status, supervisor = PositionerStatus(), self._supervisor
        now = self.get_clock().now().nanoseconds
        status.header.stamp, status.header.frame_id = from_ns(now), self._settings.base_frame
        status.condition_number = status.distance = float("nan")
        task, target = None, None
        if supervisor is None:
            status.message = f"waiting for {', '.join(self._watch.missing)}"
        else:
            code, task = supervisor.code, supervisor.task
            status.code, status.message = int(code), supervisor.message
            status.condition_number = supervisor.condition()
            self._reported = code
            self._diagnostics.level(OK if code < Code.STALE_JOINTS else WARN, f"{code.name}: {supervisor.message}")
            if task is not None:
                target = task.target
                status.distance = supervisor.error(task)[0]
        self._status.publish(status)
        if target is not None:
            self._target.publish(stamped(target, self._settings.base_frame, now))
        if self._markers.get_subscription_count():
            text, good = status.message, status.code < Code.STALE_JOINTS
            self._markers.publish(markers(self._settings.base_frame, now, target, self._scene.seen, text, good=good))

    def destroy_node(self) -> None:
        """Bring the arm to rest, say so, and end."""
        supervisor, loop = self._supervisor, self._loop
        if supervisor is not None and loop is not None:
            supervisor.close()
            deadline = time.monotonic() + _CLOSING_TIME
            while supervisor.is_moving and loop.is_alive and time.monotonic() < deadline:
                time.sleep(0.01)
            time.sleep(2 * self._settings.period)
            loop.stop()
            self._publish_status()
        self._scene.close()
        super().destroy_node()


def main() -> int:
    """Run the node until SIGINT or SIGTERM."""
    raise_priority()
    return run_node(PositionerNode, executor=lambda: MultiThreadedExecutor(num_threads=6))


if __name__ == "__main__":
    sys.exit(main())
