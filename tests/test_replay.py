"""The shipped bag through the real nodes, compared with its truth."""

import subprocess
import sys

import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2
from stack_testing import recorded
from stack_testing.running import START_UP, Log, wait_for

from sl_bringup.bag.reader import BagReader
from sl_bringup.processes import Executable
from sl_common import transforms
from sl_common.calibration_files import load_calibration
from sl_common.ros import clouds
from sl_common.ros.qos import STREAM_PUBLISH
from sl_common.ros.stamps import to_ns
from sl_msgs.msg import Correspondences

pytestmark = pytest.mark.processes


def test_the_bag_through_decoder_and_triangulator_matches_its_truth(stack):
    calibration = recorded.WAVY / "calibration"
    decoder = stack.start("sl_decoder", "decoder", use_sim_time=True)
    triangulator = stack.start("sl_calibration", "triangulator", use_sim_time=True, calibration_folder=calibration)
    dots = stack.peer.listen(Correspondences, "correspondences", STREAM_PUBLISH)
    points = stack.peer.listen(PointCloud2, "points", STREAM_PUBLISH)
    Log(decoder).wait_for(r"ready|waiting", START_UP)
    Log(triangulator).wait_for(r"calibration loaded", START_UP)
    # a slow rate: the test is of what comes out, not of how fast this machine is
    replay = stack.run(
        Executable("sl_bringup", "replay", arguments=[str(recorded.WAVY), "--rate", "0.25", "--wait", "60"])
    )
    wait_for(lambda: replay.returncode is not None, START_UP + 60, "end of the replay")
    assert replay.returncode == 0, replay.output()
    wait_for(lambda: len(points) >= 4, 10, "point clouds")

    poses, spots = recorded.camera_poses(), recorded.spots()
    camera = load_calibration(calibration).camera
    assert len(dots) >= 4
    for message in dots:
        base_from_camera = poses[to_ns(message.header.stamp)]
        row, col = np.array(message.row), np.array(message.col)
        seen = camera.project(transforms.apply(transforms.inverse(base_from_camera), spots[row, col]))
        distance = np.linalg.norm(np.stack([message.camera_u, message.camera_v], axis=-1) - seen, axis=1)
        assert len(row) > 700
        assert np.mean(distance < 2.0) > 0.995
        assert np.median(distance) < 0.15
    for message in points:
        fields = clouds.from_message(message)
        assert message.header.frame_id == "base_link"
        truth = spots[fields["row"], fields["col"]]
        error = np.linalg.norm(np.stack([fields["x"], fields["y"], fields["z"]], axis=-1) - truth, axis=1)
        assert len(error) > 700
        assert np.median(error) < 5e-4
        assert np.quantile(error, 0.95) < 2e-3


def test_replay_publishes_every_message_with_its_qos_and_the_clock(stack):
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import JointState

    from sl_common.ros.qos import LATCHED
    from sl_msgs.msg import Pattern

    states = stack.peer.listen(JointState, "/joint_states", 1000)
    clock = stack.peer.listen(Clock, "/clock", 1000)
    patterns = stack.peer.listen(Pattern, "/pattern", LATCHED)
    replay = stack.run(Executable("sl_bringup", "replay", arguments=[str(recorded.WAVY / "bag"), "--rate", "1.0"]))
    wait_for(lambda: replay.returncode is not None, START_UP, "end of the replay")
    assert replay.returncode == 0, replay.output()
    expected = recorded.messages("/joint_states")
    wait_for(lambda: len(states) == len(expected), 5, "all joint states")
    assert [to_ns(m.header.stamp) for m in states] == [to_ns(m.header.stamp) for m in expected]
    assert len(patterns) == 1
    assert patterns[0] == recorded.messages("/pattern")[0]
    times = [to_ns(c.clock) for c in clock]
    assert times == sorted(times)
    assert times[-1] - times[0] > 2e9
    assert np.diff(times).max() < 0.2e9


def test_a_looping_replay_ends_on_sigint(stack):
    import signal

    replay = stack.run(
        Executable("sl_bringup", "replay", arguments=[str(recorded.WAVY), "--loop", "--wait", "0", "--rate", "10"])
    )
    Log(replay).wait_for("nobody subscribes", START_UP)
    replay.signal(signal.SIGINT)
    assert replay.wait(15) == 0
    assert "Traceback" not in replay.output()


@pytest.mark.parametrize("name", ["nothing", "empty", "broken"])
def test_a_bag_that_cannot_be_read_is_one_line_and_exit_code_1(name, tmp_path):
    folder = tmp_path / name
    if name != "nothing":
        folder.mkdir()
    if name == "broken":
        (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    done = subprocess.run(
        [sys.executable, "-m", "sl_bringup.commands.replay", str(folder)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")
    assert len(done.stderr.strip().splitlines()) == 1
    assert str(folder) in done.stderr


def test_the_bag_is_small_and_holds_what_the_chain_needs():
    size = sum(p.stat().st_size for p in recorded.WAVY.rglob("*") if p.is_file())
    assert size < 4e6
    with BagReader(recorded.WAVY / "bag") as bag:
        topics = {t.name: t for t in bag.topics}
    assert topics["/camera/image_raw"].count == 5
    assert topics["/camera/camera_info"].count == 5
    assert topics["/joint_states"].count > 200
    for name in ("/pattern", "/projector/camera_info", "/robot_description"):
        assert topics[name].latched
        assert topics[name].count == 1
