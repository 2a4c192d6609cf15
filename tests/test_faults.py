"""Bad input over real DDS: one clear line, the node alive, nothing published from it, good input works afterwards."""

import re
import shutil
import time

import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2
from stack_testing import recorded
from stack_testing.running import START_UP, Log, running_stack, wait_for
from std_msgs.msg import Float64MultiArray

from sl_common.ros.qos import LATCHED, STREAM_PUBLISH
from sl_common.ros.stamps import from_ns, to_ns
from sl_msgs.msg import Correspondences, PositionerStatus

pytestmark = pytest.mark.processes

QUIET = 1.0
"""How long nothing may come out after bad input [s]."""


class Chain:
    """Decoder, triangulator and positioner, fed by the test instead of camera and robot."""

    def __init__(self, stack, folder):
        self.peer = stack.peer
        self.folder = folder
        shutil.copytree(recorded.WAVY / "calibration", folder)
        self.decoder = stack.start("sl_decoder", "decoder")
        self.triangulator = stack.start("sl_calibration", "triangulator", calibration_folder=folder)
        self.positioner = stack.start("arm_positioner", "positioner", calibration_folder=folder)
        self.dots = stack.peer.listen(Correspondences, "correspondences", STREAM_PUBLISH)
        self.points = stack.peer.listen(PointCloud2, "points", STREAM_PUBLISH)
        self.commands = stack.peer.listen(Float64MultiArray, "commands", 100)
        self.status = stack.peer.listen(PositionerStatus, "positioner/status", 10)
        self.pattern = recorded.messages("/pattern")[0]
        self._spoken: dict[str, float] = {}
        stack.peer.publish("pattern", self.pattern, LATCHED)
        stack.peer.publish("robot_description", recorded.messages("/robot_description")[0], LATCHED)
        Log(self.decoder).wait_for("pattern .* 44x58", START_UP)
        Log(self.triangulator).wait_for("calibration loaded", START_UP)
        Log(self.positioner).wait_for("arm with joints", START_UP)
        self.check()

    def good_image(self):
        """The first recorded image and the joint states around it, stamped as now."""
        image = recorded.messages("/camera/image_raw")[0]
        recorded_at = to_ns(image.header.stamp)
        states = [
            m for m in recorded.messages("/joint_states") if abs(to_ns(m.header.stamp) - recorded_at) < 60_000_000
        ]
        shift = self.now() - recorded_at - 60_000_000
        for message in [image, *states]:
            message.header.stamp = from_ns(to_ns(message.header.stamp) + shift)
        return image, states

    def listen_to(self, *nodes):
        """Return logs from now on, once the nodes may repeat a line (every five seconds at most)."""
        for node in nodes:
            time.sleep(max(0.0, self._spoken.get(node.label, -10.0) + 5.2 - time.monotonic()))
            self._spoken[node.label] = time.monotonic() + QUIET
        return [Log(node, from_now=True) for node in nodes]

    def now(self):
        return self.peer.node.get_clock().now().nanoseconds

    def send(self, image=None, states=()):
        for state in states:
            self.peer.publish("joint_states", state, 100)
        if image is not None:
            self.peer.publish("camera/image_raw", image, STREAM_PUBLISH)

    def check(self):
        """Good input goes through the whole chain."""
        deadline = time.monotonic() + START_UP
        while True:
            image, states = self.good_image()
            self.send(image, states)
            expected = to_ns(image.header.stamp)
            end = time.monotonic() + 3.0
            while time.monotonic() < end:
                if any(to_ns(m.header.stamp) == expected for m in list(self.points)):
                    return
                time.sleep(0.02)
            assert time.monotonic() < deadline, "good input does not come through any more"

    def correspondences(self):
        """Good correspondences and joint states."""
        image, states = self.good_image()
        self.send(image, states)
        stamp = to_ns(image.header.stamp)

        def found():
            return next((m for m in list(self.dots) if to_ns(m.header.stamp) == stamp), None)

        wait_for(lambda: any(to_ns(m.header.stamp) == stamp for m in list(self.points)), 10, "its points")
        return wait_for(found, 10, "correspondences of a good image"), states


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    folder = tmp_path_factory.mktemp("faults")
    with running_stack(folder) as stack:
        yield Chain(stack, folder / "calibration")


def assert_one_clear_line(log, pattern, *words):
    """A line matches, it holds the words, it is not repeated at every message, and no traceback is printed."""
    line = log.wait_for(pattern)
    for word in words:
        assert word in line, f"'{word}' is not in: {line}"
    time.sleep(QUIET)
    assert len(log.lines(pattern)) <= 2, log.text()
    assert "Traceback" not in log.text()
    assert log.process.returncode is None


def wrong_encoding(image):
    image.encoding = "yuv422"
    return ["yuv422", "bgr8"]


def short_step(image):
    image.step = 100
    return ["100", "1920"]


def short_data(image):
    image.data = image.data[: len(image.data) // 2]
    return [str(len(image.data)), "640x480"]


def empty(image):
    image.width = image.height = image.step = 0
    image.data = image.data[:0]
    return ["0x0"]


@pytest.mark.parametrize("spoil", [wrong_encoding, short_step, short_data, empty])
def test_an_image_that_cannot_be_used_is_refused_by_the_decoder(chain, spoil):
    [log] = chain.listen_to(chain.decoder)
    image, states = chain.good_image()
    words, seen = spoil(image), len(chain.dots)
    for _ in range(5):
        chain.send(image, states)
        time.sleep(0.05)
    assert_one_clear_line(log, "image refused", *words)
    assert len(chain.dots) == seen
    chain.check()


def test_a_pattern_whose_id_is_not_that_of_its_contents_is_refused_by_the_decoder(chain):
    [log] = chain.listen_to(chain.decoder)
    bad = recorded.messages("/pattern")[0]
    bad.pattern_id = "0123456789abcdef"
    chain.peer.publish("pattern", bad, LATCHED)
    assert_one_clear_line(log, "pattern refused", "0123456789abcdef", chain.pattern.pattern_id)
    chain.peer.publish("pattern", chain.pattern, LATCHED)
    chain.check()


def test_a_pattern_of_the_wrong_length_is_refused_by_the_decoder(chain):
    [log] = chain.listen_to(chain.decoder)
    bad = recorded.messages("/pattern")[0]
    bad.symbols = bad.symbols[:-1]
    chain.peer.publish("pattern", bad, LATCHED)
    assert_one_clear_line(log, "pattern refused", str(len(bad.symbols)), "44x58")
    chain.peer.publish("pattern", chain.pattern, LATCHED)
    chain.check()


def test_correspondences_of_another_pattern_give_no_points(chain):
    message, _ = chain.correspondences()
    [log] = chain.listen_to(chain.triangulator)
    seen = len(chain.points)
    message.pattern_id = "another"
    for k in range(5):
        message.header.stamp = from_ns(to_ns(message.header.stamp) + k)
        chain.peer.publish("correspondences", message, STREAM_PUBLISH)
        time.sleep(0.05)
    assert_one_clear_line(log, "no points", "another", chain.pattern.pattern_id)
    assert len(chain.points) == seen
    chain.check()


def test_correspondences_with_arrays_of_different_length_give_no_points(chain):
    message, _ = chain.correspondences()
    [log] = chain.listen_to(chain.triangulator)
    seen = len(chain.points)
    message.camera_u = message.camera_u[:-1]
    chain.peer.publish("correspondences", message, STREAM_PUBLISH)
    assert_one_clear_line(log, "no points", str(len(message.camera_u)), str(len(message.camera_v)))
    assert len(chain.points) == seen
    chain.check()


def unknown_names(state):
    state.name = [f"joint_{k}" for k in range(len(state.name))]
    return ["shoulder_pan_joint", "joint_0"]


def nan_position(state):
    state.position[2] = float("nan")
    return ["elbow_joint"]


def short_positions(state):
    state.position = state.position[:3]
    return ["6", "3"]


@pytest.mark.parametrize("spoil", [unknown_names, nan_position, short_positions])
def test_joint_states_that_cannot_be_used_are_refused_and_nothing_is_derived_from_them(chain, spoil):
    logs = chain.listen_to(chain.triangulator, chain.positioner)
    image, states = chain.good_image()
    words = []
    for state in states:
        words = spoil(state)
    seen = len(chain.points)
    chain.send(image, states)
    for log in logs:
        assert_one_clear_line(log, r"joint[_ ]states? (refused|not used)", *words)
    assert len(chain.points) == seen
    assert not chain.commands
    chain.check()


def test_a_goal_without_usable_joint_states_moves_nothing_and_says_why(chain):
    from rclpy.action import ActionClient

    from sl_msgs.action import PositionArm

    time.sleep(0.5)  # the last joint states are now too old
    client = ActionClient(chain.peer.node, PositionArm, "positioner/position_arm")
    assert client.wait_for_server(START_UP)
    goal = PositionArm.Goal(standoff=0.4, duration=3.0)
    sent = chain.peer.thread.run(lambda: client.send_goal_async(goal))
    handle = wait_for(lambda: sent.done() and sent.result(), 20, "an answer to the goal")
    if handle.accepted:
        future = chain.peer.thread.run(handle.get_result_async)
        result = wait_for(lambda: future.done() and future.result(), 30, "the result").result
        assert not result.success
        assert re.search(r"\d", result.message), "the message holds no number"
    assert not chain.commands
    assert chain.positioner.returncode is None
    chain.peer.thread.run(client.destroy)


def broken_calibration(folder, name):
    if name == "missing":
        (folder / "projector.yaml").unlink()
        return ["projector.yaml"]
    if name == "unreadable":
        (folder / "hand_eye.yaml").write_text("flange_from_camera: [[1, 0, 0\n")
        return ["hand_eye.yaml", "line"]
    if name == "binary":
        (folder / "projector_pose.yaml").write_bytes(b"\xff\xfe\x00\x80")
        return ["projector_pose.yaml"]
    (folder / "hand_eye.yaml").write_text(
        "flange_from_camera: [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
    )
    return ["hand_eye.yaml", "rigid"]


@pytest.mark.parametrize("name", ["missing", "unreadable", "binary", "not_rigid"])
def test_a_calibration_that_cannot_be_read_is_named_and_repaired_while_the_node_runs(name, tmp_path):
    folder = tmp_path / "calibration"
    shutil.copytree(recorded.WAVY / "calibration", folder)
    words = broken_calibration(folder, name)
    with running_stack(tmp_path) as stack:
        triangulator = stack.start("sl_calibration", "triangulator", calibration_folder=folder)
        points = stack.peer.listen(PointCloud2, "points", STREAM_PUBLISH)
        log = Log(triangulator)
        line = log.wait_for("calibration not usable", START_UP)
        for word in words:
            assert word in line
        stack.peer.publish("robot_description", recorded.messages("/robot_description")[0], LATCHED)
        stack.peer.publish("pattern", recorded.messages("/pattern")[0], LATCHED)
        message = Correspondences(pattern_id=recorded.messages("/pattern")[0].pattern_id)
        states = recorded.messages("/joint_states")[:20]
        message.header.stamp = states[10].header.stamp
        message.camera_u = message.camera_v = message.confidence = np.ones(1, np.float32)
        message.projector_u = message.projector_v = np.ones(1, np.float32)
        message.row = message.col = np.zeros(1, np.uint16)
        deadline = time.monotonic() + START_UP
        while not log.lines("no points"):  # again, until the node has found this publisher
            assert time.monotonic() < deadline, log.text()
            for state in states:
                stack.peer.publish("joint_states", state, 100)
            stack.peer.publish("correspondences", message, STREAM_PUBLISH)
            time.sleep(0.2)
        time.sleep(QUIET)
        assert not points
        assert "Traceback" not in log.text()
        assert triangulator.returncode is None
        for file in (recorded.WAVY / "calibration").iterdir():
            shutil.copy(file, folder)
        log.wait_for("calibration loaded", 10)
        assert triangulator.stop() == 0


@pytest.mark.parametrize(
    ("package", "name", "parameter", "content"),
    [
        ("pattern_gen", "pattern_publisher", "pattern_file", "grid: [square"),
        ("pattern_gen", "pattern_publisher", "pattern_file", None),
        ("sl_decoder", "decoder", "colours_file", "letters: [1, 2"),
        ("sl_decoder", "decoder", "colours_file", None),
    ],
)
def test_a_file_given_by_parameter_that_cannot_be_read_is_one_line_and_exit_code_1(
    package, name, parameter, content, tmp_path
):
    path = tmp_path / "file.yaml"
    if content is not None:
        path.write_text(content)
    with running_stack(tmp_path) as stack:
        process = stack.start(package, name, **{parameter: path})
        wait_for(lambda: process.returncode is not None, START_UP, "its end")
        assert process.returncode == 1
        errors = [line for line in process.output().splitlines() if "error" in line.lower()]
        assert len(errors) == 1
        assert str(path) in errors[0]
        assert "Traceback" not in process.output()
