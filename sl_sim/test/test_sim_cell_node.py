"""The node as a process over DDS."""

import json
import os
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import PoseStamped
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Float64MultiArray, Header, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from pattern_gen import default_pattern
from sl_common import transforms
from sl_common.joint_buffer import JointBuffer
from sl_common.ros import images, qos, stamps
from sl_sim import arm

DOMAIN = 55
NAMES = arm.kinematics().joint_names
ORDER = list(reversed(NAMES))
ARGUMENTS = ["-p", "scene:=plane", "-p", "camera_width:=320", "-p", "camera_height:=240", "-p", "focal_length:=410",
             "-p", f"joints:=[{','.join(ORDER)}]", "-p", "object_sway:=[0.0, 0.02, 0.0]"]  # fmt: skip
pytestmark = pytest.mark.processes


def environment():
    return {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def start(arguments, log):
    command = [sys.executable, "-m", "sl_sim.node", "--ros-args", *arguments]
    return subprocess.Popen(command, env=environment(), stdout=log, stderr=subprocess.STDOUT, text=True)


def stop(process):
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    try:
        return process.wait(20)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        raise


class Peer:
    """What stands around the cell: projector, robot controller, listeners."""

    def __init__(self):
        self.context = Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node("peer", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.images, self.infos, self.poses, self.states, self.truths, self.urdf = [], [], [], [], [], []
        listen = self.node.create_subscription
        listen(Image, "camera/image_raw", self.images.append, qos.STREAM_SUBSCRIBE)
        listen(CameraInfo, "camera/camera_info", self.infos.append, qos.STREAM_SUBSCRIBE)
        listen(PoseStamped, "cell/truth/camera_pose", self.poses.append, QoSProfile(depth=10))
        listen(JointState, "joint_states", self.states.append, QoSProfile(depth=500))
        listen(String, "cell/truth", lambda m: self.truths.append(json.loads(m.data)), qos.LATCHED)
        listen(String, "robot_description", self.urdf.append, qos.LATCHED)
        self.projector = self.node.create_publisher(Image, "projector/image", qos.LATCHED)
        self.commands = self.node.create_publisher(Float64MultiArray, "commands", QoSProfile(depth=50))
        self.trajectory = self.node.create_publisher(JointTrajectory, "joint_trajectory", QoSProfile(depth=50))

    def spin_until(self, condition, timeout=40.0):
        end = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end, "timed out"
            self.executor.spin_once(timeout_sec=0.01)

    def spin_for(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.01)

    def call(self, kind, name, request):
        client = self.node.create_client(kind, name)
        self.spin_until(client.service_is_ready)
        future = client.call_async(request)
        self.spin_until(future.done)
        return future.result()

    def report(self):
        self.truths.clear()
        self.spin_until(lambda: len(self.truths) > 1)
        return self.truths[-1]["report"]

    def positions(self):
        self.states.clear()
        self.spin_until(lambda: self.states)
        return np.array(self.states[-1].position)

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    path = tmp_path_factory.mktemp("cell") / "log"
    with path.open("w") as log:
        process, peer = start(ARGUMENTS, log), Peer()
        try:
            peer.spin_until(lambda: peer.truths and peer.states and peer.urdf)
            yield SimpleNamespace(process=process, peer=peer, log=path)
        finally:
            peer.close()
            stop(process)


def test_joint_states_come_one_control_period_apart_with_encoder_noise(cell):
    peer = cell.peer
    peer.states.clear()
    peer.spin_for(1.0)
    times = np.array([stamps.to_ns(m.header.stamp) for m in peer.states])
    assert len(times) > 80
    assert (np.diff(times) == 8_000_000).all()
    q = np.array([m.position for m in peer.states])
    assert tuple(peer.states[0].name) == NAMES
    assert 5e-6 < q.std(0).max() < 4e-5
    np.testing.assert_allclose(q.mean(0), peer.truths[-1]["start_positions"], atol=2e-5)
    assert "ur5e" in peer.urdf[-1].data


def test_images_show_what_the_projector_shows_from_where_the_camera_truly_is(cell):
    peer = cell.peer
    peer.spin_until(lambda: peer.images)
    dark = images.to_bgr(peer.images[-1])
    peer.projector.publish(images.to_message(np.ascontiguousarray(default_pattern().render()[..., ::-1]), Header()))
    contrast = lambda m: np.abs(np.diff(images.to_bgr(m).max(-1).astype(int), axis=1)).mean()  # noqa: E731
    peer.spin_until(lambda: contrast(peer.images[-1]) > 3 * np.abs(np.diff(dark.max(-1).astype(int), axis=1)).mean())
    message = peer.images[-1]
    assert (message.width, message.height, message.encoding) == (320, 240, "bgr8")
    assert message.header.frame_id == "camera_optical_frame"
    stamp = message.header.stamp
    matching = lambda messages: [m for m in messages if m.header.stamp == stamp]  # noqa: E731
    peer.spin_until(lambda: matching(peer.infos) and matching(peer.poses))
    info, pose = matching(peer.infos)[0], matching(peer.poses)[0]
    assert info.distortion_model == "plumb_bob"
    assert info.d[0] < 0
    buffer = JointBuffer()
    for state in peer.states:
        buffer.add(stamps.to_ns(state.header.stamp), np.array(state.position))
    expected = arm.kinematics().forward(buffer.at(stamps.to_ns(stamp))) @ np.array(
        peer.truths[-1]["flange_from_camera"]
    )
    p, o = pose.pose.position, pose.pose.orientation
    got = transforms.from_quaternion([p.x, p.y, p.z], [o.x, o.y, o.z, o.w])
    np.testing.assert_allclose(got, expected, atol=2e-4)


def gentle(start_, offset, n=200):
    s = np.linspace(0, 1, n)[:, None]
    return start_ + offset * s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)


def send(peer, setpoints, publish):
    """One setpoint a control period, several at once where this process was late."""
    begin, k = time.monotonic(), 0
    while k < len(setpoints):
        while k < len(setpoints) and time.monotonic() >= begin + 0.008 * k:
            publish(setpoints[k])
            k += 1
        peer.executor.spin_once(timeout_sec=0.002)
    peer.spin_for(0.8)


def test_both_command_topics_move_the_joints_that_they_name(cell):
    peer = cell.peer
    peer.call(Trigger, "cell/reset", Trigger.Request())
    offset, begin = np.array([0.05, -0.04, 0.03, 0.02, -0.05, 0.06]), peer.positions()
    to_order = [NAMES.index(name) for name in ORDER]
    send(peer, gentle(begin, offset), lambda q: peer.commands.publish(Float64MultiArray(data=q[to_order].tolist())))
    np.testing.assert_allclose(peer.positions(), begin + offset, atol=1e-4)

    def publish(q):
        point = JointTrajectoryPoint(positions=q[to_order].tolist(), time_from_start=Duration(nanosec=8_000_000))
        peer.trajectory.publish(JointTrajectory(joint_names=ORDER, points=[point]))

    send(peer, gentle(peer.positions(), -offset), publish)
    np.testing.assert_allclose(peer.positions(), begin, atol=2e-4)
    report = peer.report()
    assert (report["setpoints"], report["streams"]) == (400, 2)
    assert report["violations_total"] == report["first_setpoint_jumps"] == report["refused"] == 0


def test_a_jump_is_counted_and_reset_brings_the_arm_back(cell):
    peer = cell.peer
    peer.call(Trigger, "cell/reset", Trigger.Request())
    start_ = np.array(peer.truths[-1]["start_positions"])
    to_order = [NAMES.index(name) for name in ORDER]
    for q in (start_, start_, start_ + 0.1, start_ + 0.1):
        peer.commands.publish(Float64MultiArray(data=q[to_order].tolist()))
    peer.spin_for(0.5)
    violations = peer.report()["violations"]
    assert violations["velocity"] == 1
    assert violations["acceleration"] >= 1
    assert violations["jerk"] >= 1
    assert violations["position"] == 0
    assert peer.call(Trigger, "cell/reset", Trigger.Request()).success
    np.testing.assert_allclose(peer.positions(), start_, atol=1e-4)
    assert peer.report()["violations_total"] == 0


def test_bad_messages_are_refused_with_a_reason_and_harm_nothing(cell):
    peer = cell.peer
    peer.call(Trigger, "cell/reset", Trigger.Request())
    begin = peer.positions()
    peer.commands.publish(Float64MultiArray(data=[0.0] * 5))
    peer.commands.publish(Float64MultiArray(data=[np.nan] * 6))
    peer.trajectory.publish(JointTrajectory(joint_names=["a", "b"], points=[JointTrajectoryPoint()]))
    peer.projector.publish(images.to_message(np.zeros((10, 20, 3), np.uint8), Header()))
    broken = images.to_message(np.zeros((768, 1024, 3), np.uint8), Header())
    broken.encoding = "yuv422"
    peer.projector.publish(broken)
    peer.spin_for(0.5)
    report = peer.report()
    assert report["refused"] == 3
    assert report["streams"] == 0
    np.testing.assert_allclose(peer.positions(), begin, atol=1e-4)
    assert cell.process.poll() is None
    text = cell.log.read_text()
    assert "setpoint refused" in text
    assert "lacks shoulder_pan_joint" in text
    assert "projector/image ignored" in text
    assert "Traceback" not in text


def test_the_object_moves_when_told(cell):
    peer = cell.peer
    poses = []
    peer.node.create_subscription(PoseStamped, "cell/truth/object_pose", poses.append, QoSProfile(depth=10))
    assert peer.call(SetBool, "cell/move_object", SetBool.Request(data=True)).success
    peer.spin_until(lambda: poses and abs(poses[-1].pose.position.y) > 2e-3)
    assert peer.call(SetBool, "cell/move_object", SetBool.Request(data=False)).success
    peer.spin_until(lambda: abs(poses[-1].pose.position.y) < 1e-9)


def test_sigint_ends_it_cleanly_with_the_counts(tmp_path):
    with (tmp_path / "log").open("w") as log:
        process, peer = start(["-p", "scene:=plane", "-r", "__node:=second", "-r", "joint_states:=other"], log), Peer()
        try:
            seen = []
            peer.node.create_subscription(JointState, "other", seen.append, QoSProfile(depth=10))
            peer.spin_until(lambda: seen)
        finally:
            peer.close()
            code = stop(process)
    assert code == 0
    text = (tmp_path / "log").read_text()
    assert "0 setpoints in 0 streams" in text
    assert "Traceback" not in text


@pytest.mark.parametrize(
    ("argument", "words"),
    [("scene:=teapot", "teapot"), ("control_rate:=0.5", "control_rate"), ("joints:=[a]", "shoulder_pan_joint")],
)
def test_a_bad_parameter_is_one_clear_line_and_exit_code_1(argument, words):
    command = [sys.executable, "-m", "sl_sim.node", "--ros-args", "-p", argument]
    done = subprocess.run(command, env=environment(), capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    lines = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1
    assert words in lines[0]
    assert "Traceback" not in done.stderr


def children(pid):
    listed = subprocess.run(["ps", "-o", "pid=", "--ppid", str(pid)], capture_output=True, text=True, check=False)
    return [int(line) for line in listed.stdout.split()]


def test_a_killed_node_leaves_no_process_behind(tmp_path):
    with (tmp_path / "log").open("w") as log:
        process, peer = start(["-p", "scene:=plane", "-r", "joint_states:=third"], log), Peer()
        try:
            seen = []
            peer.node.create_subscription(JointState, "third", seen.append, QoSProfile(depth=10))
            peer.spin_until(lambda: seen)
            begun = children(process.pid)
        finally:
            peer.close()
            process.kill()
            process.wait()
    assert begun
    end = time.monotonic() + 20
    alive = lambda: [pid for pid in begun if os.path.exists(f"/proc/{pid}")]  # noqa: E731
    while alive():
        assert time.monotonic() < end, f"still running: {alive()}"
        time.sleep(0.1)
