"""A driver with one arm for the node tests: takes setpoints over DDS, publishes joint states, checks every command."""

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from positioner_checks import limit_violations
from positioner_robots import HOME, URDFS, kinematics
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Float64MultiArray, Header, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from arm_positioner.limits import JointLimits
from arm_positioner.setpoint_loop import raise_priority
from sl_common import transforms
from sl_common.ros import clouds
from sl_common.ros.qos import LATCHED, STREAM_PUBLISH
from sl_msgs.action import PositionArm
from sl_msgs.msg import PositionerStatus

PERIOD = 1 / 125
PATIENCE = {"joint_timeout": 0.8, "target_timeout": 0.5}  # the tests share a busy machine; [s]
ACCELERATION, JERK, SCALE = 2.5, 25.0, 0.5  # the node's defaults


def own_domain(first: int) -> int:
    """Return a ROS domain of this test worker's own: ``first`` or the one after it."""
    return first + int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:]) % 2


class Cell:
    """The test's side of the graph: driver, camera and operator in one.

    Attributes:
        commands: Every setpoint received, in order of arrival, in the order of the arm's joints.
        statuses: Every change of (code, message).
        silent: Publishes no joint states while set.
        blocked: Ignores commands while set.
        corrupt: Replaces outgoing joint states: a function of the message.
        scene: Function of time that returns points (N, 3) in the base frame, row, col; None: no clouds.
    """

    def __init__(self, robot: str, domain: int, *, command_order: list[str] | None = None) -> None:
        self.arm = kinematics(robot)
        self.names = list(self.arm.joint_names)
        self._command_index = [(command_order or self.names).index(n) for n in self.names]
        self.q = HOME[robot].copy()
        self._goal = self.q.copy()
        self.commands: list[np.ndarray] = []
        self._before: list[np.ndarray] = []
        self.command_times: list[float] = []
        self.trajectories: list[JointTrajectory] = []
        self.statuses: list[tuple[int, str]] = []
        self.status: PositionerStatus | None = None
        self.silent = self.blocked = False
        self.longest_gap = 0.0  # between joint states [s]
        self.lag = 0.02
        self.noise = 0.0
        self.stamp_offset = 0.0
        self.corrupt: Callable[[JointState], None] | None = None
        self.scene: Callable[[float], tuple] | None = None
        self.cloud_frame = "base_link"
        self._rng = np.random.default_rng(0)
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = rclpy.create_node("test_cell", context=self._context)
        self._joints = self.node.create_publisher(JointState, "joint_states", 10)
        self._points = self.node.create_publisher(PointCloud2, "points", STREAM_PUBLISH)
        self.target_pose = self.node.create_publisher(PoseStamped, "positioner/target_pose", 10)
        self._description = self.node.create_publisher(String, "robot_description", LATCHED)
        self._description.publish(String(data=URDFS[robot]()))
        self.node.create_subscription(Float64MultiArray, "commands", self._on_command, 100)
        self.node.create_subscription(JointTrajectory, "joint_trajectory", self._on_trajectory, 100)
        self.node.create_subscription(PositionerStatus, "positioner/status", self._on_status, 100)
        self.diagnostics: dict[str, str] = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.action = ActionClient(self.node, PositionArm, "positioner/position_arm")
        self.pause = self.node.create_client(SetBool, "positioner/pause")
        self.stop = self.node.create_client(Trigger, "positioner/stop")
        raise_priority()  # the machine may be busy; a real driver would not be
        sys.setswitchinterval(5e-4)  # the driver's thread must not wait for the others
        self._ended = threading.Event()
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._threads = [
            threading.Thread(target=self._spin, daemon=True),
            threading.Thread(target=self._drive, daemon=True),
            threading.Thread(target=self._look, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join(timeout=2)
        self._executor.shutdown(timeout_sec=1)
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    def _spin(self) -> None:
        while not self._ended.is_set():
            self._executor.spin_once(timeout_sec=0.1)

    def _drive(self) -> None:
        sent = time.monotonic()
        while not self._ended.wait(PERIOD):
            if not self.blocked:
                goal = self._scheduled() if self.trajectories else self._goal
                self.q = self.q + (goal - self.q) * min(1.0, PERIOD / max(self.lag, PERIOD))
            if self.silent:
                continue
            measured = self.q + self.noise * self._rng.normal(size=self.q.size)
            order = self._rng.permutation(len(self.names))  # joint states come in any order, with others between
            message = JointState(
                name=["gripper", *(self.names[i] for i in order)], position=[0.3, *(float(measured[i]) for i in order)]
            )
            message.header.stamp = self.stamp(self.stamp_offset)
            if self.corrupt is not None:
                self.corrupt(message)
            self._joints.publish(message)
            self.longest_gap = max(self.longest_gap, time.monotonic() - sent)
            sent = time.monotonic()

    def _look(self) -> None:
        while not self._ended.wait(0.1):
            if self.scene is None:
                continue
            header = Header(frame_id=self.cloud_frame, stamp=self.stamp())
            seen = self.scene(time.monotonic())
            points = seen[0].astype(np.float32)
            fields = {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2]}
            fields["confidence"] = np.ones(len(points), np.float32)
            fields["row"], fields["col"] = seen[1].astype(np.uint16), seen[2].astype(np.uint16)
            self._points.publish(clouds.to_message(header, **fields))

    def stamp(self, offset: float = 0.0):
        return (self.node.get_clock().now() + rclpy.duration.Duration(seconds=offset)).to_msg()

    def _on_command(self, message: Float64MultiArray) -> None:
        command = np.array(message.data)[self._command_index]
        self.commands.append(command)
        self.command_times.append(time.monotonic())
        self._goal = command

    def _on_trajectory(self, message: JointTrajectory) -> None:
        self.trajectories.append(message)

    def _scheduled(self) -> np.ndarray:
        """Where the newest trajectory is by the clock, linear between its points."""
        message = self.trajectories[-1]
        begin = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        now = 1e-9 * self.node.get_clock().now().nanoseconds
        times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points]
        index = [list(message.joint_names).index(n) for n in self.names]
        positions = np.array([p.positions for p in message.points])[:, index]
        return np.array([np.interp(now - begin, times, column) for column in positions.T])

    def _on_status(self, message: PositionerStatus) -> None:
        self.status = message
        if not self.statuses or self.statuses[-1][0] != message.code:
            self.statuses.append((message.code, message.message))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "positioner":
                self.diagnostics = {v.key: v.value for v in status.values}

    @property
    def codes(self) -> list[int]:
        return [code for code, _ in self.statuses]

    def wait(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                raise AssertionError(f"{what} not within {timeout} s; statuses {self.statuses}")
            time.sleep(0.01)

    def wait_for_code(self, code: int, timeout: float = 5.0) -> str:
        self.wait(lambda: self.status is not None and self.status.code == code, timeout, f"status {code}")
        assert self.status is not None
        return self.status.message

    def wait_for_rest(self, timeout: float = 5.0) -> None:
        self.wait(lambda: not self.command_times or time.monotonic() - self.command_times[-1] > 0.2, timeout, "rest")

    def in_executor(self, function: Callable):
        """Call where answers are handled: from elsewhere an answer may come before its request has been noted."""
        task = self._executor.create_task(function)
        self.wait(task.done, 5, "the executor")
        return task.result()

    def call(self, client, request, timeout: float = 5.0):
        assert client.wait_for_service(timeout_sec=timeout)
        future = self.in_executor(lambda: client.call_async(request))
        self.wait(future.done, timeout, "answer")
        return future.result()

    def send_goal(self, **fields):
        """Send a goal and return its handle."""
        assert self.action.wait_for_server(timeout_sec=10)
        future = self.in_executor(lambda: self.action.send_goal_async(PositionArm.Goal(**fields)))
        self.wait(future.done, 5, "acceptance")
        return future.result()

    def result(self, handle, timeout: float = 10.0) -> PositionArm.Result:
        future = self.in_executor(handle.get_result_async)
        self.wait(future.done, timeout, "result")
        return future.result().result

    def pose_goal(self, camera_from_goal: np.ndarray) -> PoseStamped:
        """Return the goal that is ``camera_from_goal`` away from the present pose of the flange, in the base frame."""
        return self.pose_message(self.arm.forward(self.q) @ camera_from_goal)

    def pose_message(self, base_from_goal: np.ndarray, frame: str = "base_link") -> PoseStamped:
        message = PoseStamped()
        message.header.frame_id, message.header.stamp = frame, self.stamp()
        translation, quaternion = transforms.to_quaternion(base_from_goal)
        p, o = message.pose.position, message.pose.orientation
        p.x, p.y, p.z = translation.tolist()
        o.x, o.y, o.z, o.w = quaternion.tolist()
        return message

    def reset(self) -> None:
        """Undo what a test has done to the cell; commands and statuses are counted anew."""
        self.silent = self.blocked = False
        self.noise = self.stamp_offset = 0.0
        self.corrupt = self.scene = None
        self.wait_for_rest()
        time.sleep(0.3)
        self.wait(lambda: self.status is not None, 15, "a status")
        self._before = self.commands[-1:] or self._before
        self.commands, self.command_times, self.statuses = [], [], []

    def drop_setpoint(self) -> None:
        """Hold where the arm is, as a driver does after a fault."""
        self._goal = self.q.copy()
        self.commands = [self._goal]

    def violations(self) -> list[str]:
        """Check every command against the limits by differences."""
        if not self.commands:
            return []
        arm, ones = self.arm, np.ones(self.q.size)
        velocity = np.minimum(3.0, SCALE * arm.max_velocity)
        limits = JointLimits(arm.joint_names, arm.lower, arm.upper, velocity, ACCELERATION * ones, JERK * ones)
        return limit_violations(np.array(self._before + self.commands), limits, PERIOD)


def _die_with_parent() -> None:
    """Leave no node behind where the tests are killed (Linux)."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


class Positioner:
    """The node under test, a process of its own."""

    def __init__(self, domain: int, **parameters) -> None:
        parameters = PATIENCE | parameters
        arguments = [f"-p{k}:={v}" for k, v in parameters.items()]
        arguments = [a for item in arguments for a in ("-p", item[2:])]
        self._lines: list[str] = []
        environment = os.environ | {
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        }
        self.process = subprocess.Popen(
            [sys.executable, "-m", "arm_positioner.node", "--ros-args", *arguments],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            preexec_fn=_die_with_parent,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        self._lines.extend(self.process.stdout)

    @property
    def output(self) -> str:
        """What the node has said so far."""
        return "".join(self._lines)

    def kill(self) -> None:
        """As a power cut would."""
        self.process.kill()
        self.process.wait()

    def end(self, timeout: float = 10.0) -> tuple[int, str]:
        """SIGINT; return the exit code and the output."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        try:
            code = self.process.wait(timeout=timeout)
        except subprocess.TimeoutExpired:
            self.process.kill()
            code = -9
        self._reader.join(timeout=2)
        return code, self.output
