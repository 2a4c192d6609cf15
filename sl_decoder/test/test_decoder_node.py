"""The decoder node as a process: waits and says so, decodes, refuses bad input with one line and lives on.

Stops cleanly.
"""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from decoder_helpers import camera_image, default_pattern

rclpy = pytest.importorskip("rclpy")
sl_msgs = pytest.importorskip("sl_msgs.msg")

from sensor_msgs.msg import Image  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from pattern_gen.ros_conversions import pattern_to_message  # noqa: E402
from sl_common.ros.images import to_message  # noqa: E402
from sl_common.ros.qos import LATCHED, STREAM_PUBLISH, STREAM_SUBSCRIBE  # noqa: E402
from sl_msgs.msg import Correspondences  # noqa: E402
from sl_msgs.msg import Pattern as PatternMessage  # noqa: E402

DOMAIN = 27
pytestmark = pytest.mark.processes


class Bench:
    """A decoder process, and a node that feeds it."""

    def __init__(self, log_path) -> None:
        self.log_path = log_path
        environment = {**os.environ, "ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        with open(log_path, "w") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "sl_decoder.node"], env=environment, stdout=log, stderr=subprocess.STDOUT
            )
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node("decoder_test", context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.images = self.node.create_publisher(Image, "camera/image_raw", STREAM_PUBLISH)
        self.patterns = self.node.create_publisher(PatternMessage, "pattern", LATCHED)
        self.received: list[Correspondences] = []
        self.overlays: list[Image] = []
        self.node.create_subscription(Correspondences, "correspondences", self.received.append, STREAM_SUBSCRIBE)

    def log(self) -> str:
        return self.log_path.read_text()

    def wait(self, condition, timeout: float = 60.0) -> bool:
        end = time.monotonic() + timeout
        while time.monotonic() < end:
            if condition():
                return True
            self.executor.spin_once(timeout_sec=0.05)
        return False

    def show(self, image: np.ndarray, stamp: int = 1, encoding: str = "bgr8") -> None:
        header = Header(frame_id="camera_optical_frame")
        header.stamp.sec = stamp
        self.images.publish(to_message(image, header, encoding))

    def close(self) -> int:
        self.process.send_signal(signal.SIGINT)
        try:
            code = self.process.wait(15)
        except subprocess.TimeoutExpired:
            self.process.kill()
            code = self.process.wait()
        self.node.destroy_node()
        self.context.try_shutdown()
        return code


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    bench = Bench(tmp_path_factory.mktemp("node") / "log.txt")
    yield bench
    if bench.process.poll() is None:
        bench.close()


def show_until(bench: Bench, image: np.ndarray, count: int, stamp: int, timeout: float = 40.0) -> bool:
    end = time.monotonic() + timeout
    while time.monotonic() < end and len(bench.received) < count:
        bench.show(image, stamp)
        bench.wait(lambda: len(bench.received) >= count, 1.0)
    return len(bench.received) >= count


def test_it_says_what_it_waits_for(bench: Bench) -> None:
    assert bench.wait(lambda: "waiting for /pattern (sl_msgs/msg/Pattern; reliable, transient local" in bench.log(), 90)


def test_it_decodes(bench: Bench) -> None:
    pattern = default_pattern()
    bench.patterns.publish(pattern_to_message(pattern, Header(frame_id="projector")))
    assert bench.wait(lambda: f"pattern {pattern.pattern_id}" in bench.log())
    assert show_until(bench, camera_image(pattern, 640, 480), 1, stamp=7)
    message = bench.received[-1]
    assert message.pattern_id == pattern.pattern_id
    assert message.header.stamp.sec == 7
    assert message.header.frame_id == "camera_optical_frame"
    arrays = ("camera_u", "camera_v", "projector_u", "projector_v", "row", "col", "confidence", "corrected", "track_id")
    assert {len(getattr(message, name)) for name in arrays} == {len(message.row)}
    assert len(message.row) > 2400
    assert message.decode_time > 0
    row, col = np.array(message.row), np.array(message.col)
    assert np.allclose(message.projector_u, pattern.centers[row, col, 0])


def test_bad_images_are_refused_and_the_node_lives(bench: Bench) -> None:
    before = len(bench.received)
    header = Header()
    bench.images.publish(Image(header=header, height=480, width=640, encoding="bgr8", step=3, data=[0] * 100))
    assert bench.wait(lambda: "image refused: image step is 3 bytes" in bench.log(), 20)
    time.sleep(5.2)  # the refusals are throttled
    bench.images.publish(Image(header=header, height=2, width=2, encoding="yuv422", step=4, data=[0] * 8))
    assert bench.wait(lambda: "image refused: image encoding 'yuv422'" in bench.log(), 20)
    assert len(bench.received) == before
    assert show_until(bench, camera_image(default_pattern(), 640, 480), before + 1, stamp=9)


def test_a_bad_pattern_is_refused_and_the_old_one_stays(bench: Bench) -> None:
    message = pattern_to_message(default_pattern(), Header())
    message.pattern_id = "0123456789abcdef"
    bench.patterns.publish(message)
    assert bench.wait(lambda: "pattern refused" in bench.log(), 20)
    before = len(bench.received)
    assert show_until(bench, camera_image(default_pattern(), 640, 480), before + 1, stamp=11)
    assert len(bench.received[-1].row) > 2400


def test_debug_image_when_subscribed(bench: Bench) -> None:
    bench.node.create_subscription(Image, "decoder/debug_image", bench.overlays.append, STREAM_SUBSCRIBE)
    end = time.monotonic() + 20
    while time.monotonic() < end and not bench.overlays:
        bench.show(camera_image(default_pattern(), 640, 480), 13)
        bench.wait(lambda: bool(bench.overlays), 1.0)
    assert bench.overlays
    assert bench.overlays[0].width == 1280


def test_it_stops_cleanly(bench: Bench) -> None:
    assert bench.close() == 0
    assert "Traceback" not in bench.log()


def test_a_bad_parameter_ends_it_with_one_line() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "sl_decoder.node", "--ros-args", "-p", "min_confidence:=3.0"],
        env={**os.environ, "ROS_DOMAIN_ID": str(DOMAIN + 1), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.strip().splitlines()[-1].startswith("error: ")
