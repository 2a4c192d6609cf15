"""Goals and faults over DDS, against a driver that checks every setpoint; one node serves all tests."""

import os
import time

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("sl_msgs")
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

from positioner_cell import PATIENCE, Cell, Positioner, own_domain
from positioner_robots import HOME
from std_srvs.srv import SetBool, Trigger

from sl_common import transforms
from sl_msgs.msg import PositionerStatus as S

pytestmark = pytest.mark.processes
DOMAIN = own_domain(40)


@pytest.fixture(scope="module")
def shared():
    cell = Cell("six", DOMAIN)
    node = Positioner(DOMAIN)
    cell.wait_for_code(S.IDLE, 20)
    cell.wait(lambda: "at rest" in cell.status.message, 20, "robot_description")
    yield cell, node
    code, output = node.end()
    cell.close()
    assert code == 0, output


@pytest.fixture
def cell(shared):
    shared[0].reset()
    return shared[0]


def shift(x=0.0, y=0.0, z=0.0, rotation=(0.0, 0.0, 0.0)) -> np.ndarray:
    return transforms.make(transforms.rotation_exp(rotation), (x, y, z))


def far_goal(cell):
    """Of two poses the one further away."""
    home = cell.arm.forward(HOME["six"])
    poses = [home, home @ shift(x=0.25, rotation=(0.2, 0.1, 0.3))]
    away = [np.linalg.norm(p[:3, 3] - cell.arm.forward(cell.q)[:3, 3]) for p in poses]
    return cell.pose_message(poses[int(np.argmax(away))])


def start_motion(cell, duration=3.0):
    """Start a motion and return its handle once it is well under way."""
    handle = cell.send_goal(use_goal_pose=True, goal_pose=far_goal(cell), duration=duration)
    assert handle.accepted
    cell.wait(lambda: len(cell.commands) > 80, 6, "motion")
    return handle


def assert_clean(cell):
    cell.wait_for_rest()
    assert cell.violations() == []


def test_reaches_a_pose_in_the_time_asked_for(cell):
    goal = far_goal(cell)
    before = cell.q.copy()
    result = cell.result(cell.send_goal(use_goal_pose=True, goal_pose=goal, duration=2.0))
    assert result.success, result.message
    assert result.code == S.REACHED
    p, o = goal.pose.position, goal.pose.orientation
    target = transforms.from_quaternion([p.x, p.y, p.z], [o.x, o.y, o.z, o.w])
    assert np.abs(transforms.difference(cell.arm.forward(cell.commands[-1]), target)).max() < 1e-5
    assert result.position_error < 1e-3
    assert result.orientation_error < 5e-3
    assert result.target.header.frame_id == "base_link"
    assert 2.0 < result.duration < 6.0
    assert len(cell.commands) == pytest.approx(2.0 * 125, abs=3)
    assert np.allclose(cell.commands[0], before, atol=1e-4)
    assert_clean(cell)
    assert S.MOVING in cell.codes
    assert cell.codes[-1] == S.REACHED


def test_goals_in_the_camera_frame_are_relative_to_the_camera(cell):
    wanted = cell.arm.forward(cell.q) @ shift(z=-0.05)
    goal = cell.pose_message(shift(z=-0.05), frame="camera_optical_frame")
    goal.header.stamp.sec = goal.header.stamp.nanosec = 0
    assert cell.result(cell.send_goal(use_goal_pose=True, goal_pose=goal)).success
    assert np.abs(transforms.difference(cell.arm.forward(cell.q), wanted)).max() < 1e-3
    assert_clean(cell)


def test_pause_rests_and_resumes(cell):
    handle = start_motion(cell)
    assert cell.call(cell.pause, SetBool.Request(data=True)).success
    assert "paused" in cell.wait_for_code(S.PAUSED)
    cell.wait_for_rest()
    resting = len(cell.commands)
    time.sleep(0.3)
    assert len(cell.commands) == resting
    assert cell.call(cell.pause, SetBool.Request(data=False)).success
    assert cell.result(handle).success
    assert_clean(cell)


def test_stop_ends_the_goal(cell):
    handle = start_motion(cell)
    assert cell.call(cell.stop, Trigger.Request()).success
    result = cell.result(handle)
    assert not result.success
    assert result.code == S.STOPPED
    assert "~/stop" in result.message
    assert_clean(cell)


def test_cancel_ends_the_goal_at_rest(cell):
    handle = start_motion(cell)
    handle.cancel_goal_async()
    assert cell.result(handle).code == S.STOPPED
    assert_clean(cell)


def test_a_new_goal_replaces_the_running_one_without_a_halt(cell):
    first = start_motion(cell)
    second = cell.send_goal(use_goal_pose=True, goal_pose=cell.pose_goal(shift(z=-0.1)), duration=1.0)
    assert cell.result(second).success
    assert cell.result(first).code == S.STOPPED
    assert_clean(cell)


def test_stale_joint_states_stop_the_arm(cell):
    handle = start_motion(cell)
    cell.silent = True
    result = cell.result(handle)
    assert result.code == S.STALE_JOINTS
    assert f"limit {PATIENCE['joint_timeout']:g} s" in result.message
    assert_clean(cell)


def test_joint_states_with_old_stamps_are_stale(cell):
    cell.stamp_offset = -2.0
    time.sleep(PATIENCE["joint_timeout"] + 0.2)
    result = cell.result(cell.send_goal(use_goal_pose=True, goal_pose=far_goal(cell)))
    assert result.code == S.STALE_JOINTS
    assert cell.commands == []


def test_a_blocked_arm_is_noticed(cell):
    handle = start_motion(cell)
    cell.blocked = True
    result = cell.result(handle)
    assert result.code == S.DRIVER_DEVIATION
    assert "off its setpoints" in result.message
    assert_clean(cell)
    cell.drop_setpoint()
    cell.blocked = False


@pytest.mark.parametrize(("how", "said"), [("nan", "not finite"), ("unknown", "lacks pan"), ("short", "positions")])
def test_bad_joint_states_are_not_used_and_named(cell, shared, how, said):
    handle = start_motion(cell)

    def corrupt(message):
        if how == "nan":
            message.position = [float("nan")] * len(message.position)
        elif how == "unknown":
            message.name = [f"other_{n}" for n in message.name]
        else:
            message.position = message.position[:3]

    cell.corrupt = corrupt
    assert cell.result(handle).code == S.STALE_JOINTS
    assert_clean(cell)
    assert said in shared[1].output


@pytest.mark.parametrize(
    ("change", "code", "said"),
    [
        ({"frame": "map"}, S.INVALID_INPUT, "frame 'map', expected 'base_link' or 'camera_optical_frame'"),
        ({"nan": True}, S.INVALID_INPUT, "not finite"),
        ({"quaternion": True}, S.INVALID_INPUT, "quaternion has length 0.000"),
        ({"far": True}, S.UNREACHABLE, "out of reach within the joint limits"),
        ({"duration": -1.0}, S.INVALID_INPUT, "duration -1 s"),
        ({"object": True}, S.INVALID_INPUT, "no hand-eye calibration"),
        ({"standoff": float("nan")}, S.INVALID_INPUT, "standoff nan"),
    ],
)
def test_goals_that_cannot_be_used_are_refused_with_the_reason(cell, change, code, said):
    goal = far_goal(cell)
    goal.header.frame_id = change.get("frame", "base_link")
    if change.get("nan"):
        goal.pose.position.x = float("nan")
    if change.get("quaternion"):
        o = goal.pose.orientation
        o.x = o.y = o.z = o.w = 0.0
    if change.get("far"):
        goal.pose.position.x = 5.0
    to_object = bool({"object", "standoff"} & set(change))
    fields = {"duration": change.get("duration", 0.0), "standoff": change.get("standoff", 0.0)}
    result = cell.result(cell.send_goal(use_goal_pose=not to_object, goal_pose=goal, **fields))
    assert not result.success
    assert result.code == code
    assert said in result.message
    time.sleep(0.2)
    assert cell.commands == []


def stream_targets(cell, path, rate=50.0):
    """Publish poses (an iterable of 4x4) as a stream of targets."""
    for pose in path:
        cell.target_pose.publish(cell.pose_message(pose))
        time.sleep(1 / rate)


def test_a_stream_of_targets_is_followed_and_going_stale_stops_it(cell):
    time.sleep(1.2)  # a new stream
    start = cell.arm.forward(cell.q)
    stream_targets(cell, (start @ shift(z=-5e-4 * k) for k in range(80)))
    assert 0.02 < np.linalg.norm(cell.arm.forward(cell.q)[:3, 3] - start[:3, 3]) < 0.045
    stream_targets(cell, [start @ shift(z=-0.04, x=0.15)] * 3)  # far enough not to arrive before it is stale
    assert f"limit {PATIENCE['target_timeout']:g} s" in cell.wait_for_code(S.STALE_TARGET)
    assert_clean(cell)


def test_stop_ends_a_stream_of_targets_for_good(cell, shared):
    time.sleep(1.2)  # a new stream
    start = cell.arm.forward(cell.q)
    stream_targets(cell, (start @ shift(y=1e-3 * k) for k in range(30)))
    assert cell.commands
    assert cell.call(cell.stop, Trigger.Request()).success
    cell.wait_for_rest()
    count = len(cell.commands)
    stream_targets(cell, (start @ shift(y=0.03) for _ in range(30)))
    assert len(cell.commands) == count
    assert "its stream was stopped" in shared[1].output
    assert_clean(cell)


def test_old_targets_are_refused(cell, shared):
    time.sleep(1.2)
    message = cell.pose_message(cell.arm.forward(cell.q) @ shift(z=-0.05))
    message.header.stamp = cell.stamp(-2 * PATIENCE["target_timeout"])
    cell.target_pose.publish(message)
    time.sleep(0.5)
    assert cell.commands == []
    assert f"limit {PATIENCE['target_timeout']:g} s" in shared[1].output


def test_diagnostics_tell_rates_and_jitter(cell):
    assert cell.result(cell.send_goal(use_goal_pose=True, goal_pose=far_goal(cell), duration=1.5)).success
    cell.wait(lambda: "setpoint interval mean [ms]" in cell.diagnostics, 5, "diagnostics")
    assert float(cell.diagnostics["setpoint interval mean [ms]"]) > 7.9  # late on a busy machine, never early
    assert float(cell.diagnostics["joint_states rate [1/s]"]) > 30
    assert_clean(cell)
