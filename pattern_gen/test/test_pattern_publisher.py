"""The node over DDS, as a process of its own."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("sl_msgs")

from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from sensor_msgs.msg import CameraInfo, Image  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from pattern_gen import default_pattern  # noqa: E402
from pattern_gen.ros_conversions import pattern_from_message, pattern_to_message  # noqa: E402
from sl_common.ros import images, qos  # noqa: E402
from sl_msgs.msg import Pattern as PatternMessage  # noqa: E402
from sl_msgs.srv import SetProjection  # noqa: E402

DOMAIN = 11
ENVIRONMENT = os.environ | {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def start(*arguments):
    command = [sys.executable, "-c", "import sys; from pattern_gen.node import main; sys.exit(main())"]
    return subprocess.Popen(
        [*command, "--ros-args", *arguments], env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def stop(process):
    process.send_signal(signal.SIGINT)
    try:
        _, error = process.communicate(timeout=20)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    return process.returncode, error


class Client:
    def __init__(self, monkeypatch):
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node("test_pattern_publisher", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.latest = {}
        for kind, topic in (
            (Image, "projector/image"),
            (CameraInfo, "projector/camera_info"),
            (PatternMessage, "pattern"),
        ):
            self.node.create_subscription(kind, topic, lambda m, t=topic: self.latest.__setitem__(t, m), qos.LATCHED)
        self.client = self.node.create_client(SetProjection, "pattern_publisher/set_projection")

    def wait(self, condition, seconds=20.0):
        end = time.monotonic() + seconds
        while not condition() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.1)
        assert condition()

    def call(self, **request):
        future = self.client.call_async(SetProjection.Request(**request))
        self.wait(future.done)
        return future.result()

    def close(self):
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def client(monkeypatch):
    client = Client(monkeypatch)
    yield client
    client.close()


def test_message_and_back_for_both_grids():
    from pattern_gen import Grid
    from pattern_gen.pattern import fit_to_projector

    for grid in Grid:
        pattern = fit_to_projector(default_pattern().symbols, default_pattern().letters, grid=grid, min_hamming=1)
        again = pattern_from_message(pattern_to_message(pattern, Header()))
        assert again.pattern_id == pattern.pattern_id
        assert np.abs(again.centers - pattern.centers).max() < 1e-3


@pytest.mark.parametrize("change", ["pattern_id", "symbols", "center_u", "grid"])
def test_inconsistent_messages_are_refused(change):
    from pattern_gen.errors import PatternError

    message = pattern_to_message(default_pattern(), Header())
    if change == "pattern_id":
        message.pattern_id = "0" * 16
    elif change == "symbols":
        message.symbols = message.symbols[:-1]
    elif change == "center_u":
        message.center_u[7] += 3.0
    else:
        message.grid = 9
    with pytest.raises(PatternError, match="pattern message"):
        pattern_from_message(message)


@pytest.mark.processes
def test_node_shows_switches_and_stops(client):
    process = start("-p", "spot_resize_period:=5.0")
    try:
        client.wait(lambda: len(client.latest) == 3)
        pattern = default_pattern()
        assert pattern_from_message(client.latest["pattern"]).pattern_id == pattern.pattern_id
        shown = images.to_bgr(client.latest["projector/image"])[..., ::-1]
        assert np.array_equal(shown, pattern.render())
        info = client.latest["projector/camera_info"]
        assert (info.width, info.height) == (1024, 768)
        client.wait(client.client.service_is_ready)

        answer = client.call(mode=SetProjection.Request.GRAY_CODE, axis=SetProjection.Request.ROWS, bit=3, inverse=True)
        assert answer.success, answer.message
        assert answer.frames == 10
        client.wait(lambda: client.latest["projector/image"].header.stamp == answer.stamp)
        shown = images.to_bgr(client.latest["projector/image"])
        assert set(np.unique(shown)) == {0, 255}
        assert (shown == shown[:, :1]).all()

        refused = client.call(mode=SetProjection.Request.GRAY_CODE, bit=10)
        assert not refused.success
        assert "bit 10" in refused.message
        assert client.latest["projector/image"].header.stamp == answer.stamp

        resized = client.call(spot_camera_px=12.0, camera_px_per_projector_px=2.0)
        assert resized.success
        assert resized.spot_diameter == pytest.approx(6.0)
        client.wait(lambda: client.latest["pattern"].spot_diameter == pytest.approx(6.0))
        assert client.latest["pattern"].pattern_id == pattern.pattern_id
        client.wait(lambda: client.latest["projector/image"].header.stamp == resized.stamp)
        shown = images.to_bgr(client.latest["projector/image"])[..., ::-1]
        assert np.array_equal(shown, pattern.render(6.0))

        early = client.call(spot_camera_px=20.0, camera_px_per_projector_px=2.0)
        assert not early.success
        assert "ask again" in early.message
        assert early.spot_diameter == pytest.approx(6.0)
    finally:
        code, error = stop(process)
    assert code == 0, error


@pytest.mark.processes
@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        (["pattern_file:=/nowhere/p.yaml"], "no such file"),
        (["spot_fraction_max:=3.0"], "spot_fraction_max"),
        (["gray_code_arrangement:=random"], "gray_code_arrangement"),
        (["calibration_folder:=/nowhere"], "/nowhere"),
    ],
)
def test_bad_parameters_end_with_one_line(parameters, words):
    process = start(*[part for parameter in parameters for part in ("-p", parameter)])
    _, error = process.communicate(timeout=30)
    assert process.returncode == 1
    line = [text for text in error.splitlines() if text.startswith("error: ")]
    assert len(line) == 1
    assert words in line[0]
    assert "Traceback" not in error


@pytest.mark.processes
def test_calibrated_colours_and_projector_are_used(client, tmp_path):
    letters = "\n".join(f"- rgb: [{200 + i}, {10 * i}, 0]" for i in range(6))
    (tmp_path / "colours.yaml").write_text(f"letters:\n{letters}\n")
    from sl_common.calibration_files import save_camera
    from sl_common.cameras import CameraModel

    matrix = np.array([[1900.0, 0, 504], [0, 1900, 856], [0, 0, 1]])
    save_camera(tmp_path / "projector.yaml", CameraModel(1024, 768, matrix))
    process = start("-p", f"colours_file:={tmp_path}/colours.yaml", "-p", f"calibration_folder:={tmp_path}")
    try:
        client.wait(lambda: len(client.latest) == 3)
        assert [tuple(letter.rgb) for letter in client.latest["pattern"].letters] == [
            (200 + i, 10 * i, 0) for i in range(6)
        ]
        assert client.latest["projector/camera_info"].k[5] == pytest.approx(856.0)
    finally:
        code, error = stop(process)
    assert code == 0, error
