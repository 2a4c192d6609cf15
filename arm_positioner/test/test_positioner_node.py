"""The node over DDS against a driver that checks every setpoint."""

import os
import signal
import time

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("sl_msgs")
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

from positioner_cell import Cell, Positioner
from positioner_robots import HOME
from std_srvs.srv import SetBool, Trigger

from sl_common import transforms
from sl_msgs.msg import PositionerStatus as S

pytestmark = pytest.mark.xdist_group("positioner_node")
DOMAIN = 40


@pytest.fixture
def cell():
    it = Cell("six", DOMAIN)
    yield it
    it.close()


@pytest.fixture
def node(cell):
    it = Positioner(DOMAIN)
    cell.wait_for_code(S.IDLE, 15)
    cell.wait(lambda: "at rest" in cell.status.message, 10, "robot_description")
    time.sleep(0.3)
    yield it
    it.end()


def shift(x=0.0, y=0.0, z=0.0, rotation=(0.0, 0.0, 0.0)) -> np.ndarray:
    return transforms.make(transforms.rotation_exp(rotation), (x, y, z))


def start_motion(cell, distance=0.25, duration=3.0):
    """Start a motion and return its handle once it is well under way."""
    goal = cell.pose_goal(shift(x=distance, rotation=(0.2, 0.1, 0.3)))
    before = len(cell.commands)
    handle = cell.send_goal(use_goal_pose=True, goal_pose=goal, duration=duration)
    assert handle.accepted
    cell.wait(lambda: len(cell.commands) > before + 80, 5, "motion")
    return handle


def assert_clean(cell):
    cell.wait_for_rest()
    assert cell.violations() == []


def test_nothing_moves_on_start_up_and_sigint_ends_with_0(cell, node):
    time.sleep(0.5)
    assert cell.commands == []
    code, output = node.end()
    assert code == 0, output
    assert cell.commands == []


def test_reaches_a_pose_in_the_time_asked_for(cell, node):
    goal = cell.pose_goal(shift(x=0.15, y=-0.1, z=0.05, rotation=(0.1, 0.3, -0.2)))
    result = cell.result(cell.send_goal(use_goal_pose=True, goal_pose=goal, duration=2.0))
    assert result.success, result.message
    assert result.code == S.REACHED
    target = transforms.from_quaternion(
        [goal.pose.position.x, goal.pose.position.y, goal.pose.position.z],
        [goal.pose.orientation.x, goal.pose.orientation.y, goal.pose.orientation.z, goal.pose.orientation.w],
    )
    delta = transforms.difference(cell.arm.forward(cell.commands[-1]), target)
    assert np.abs(delta).max() < 1e-5
    assert result.position_error < 1e-3
    assert len(cell.commands) == pytest.approx(2.0 * 125, abs=3)
    assert np.allclose(cell.commands[0], HOME["six"], atol=1e-4)
    assert_clean(cell)


def test_pause_rests_and_resumes(cell, node):
    handle = start_motion(cell)
    answer = cell.call(cell.pause, SetBool.Request(data=True))
    assert answer.success
    assert "paused" in cell.wait_for_code(S.PAUSED)
    cell.wait_for_rest()
    resting = len(cell.commands)
    time.sleep(0.3)
    assert len(cell.commands) == resting
    assert cell.call(cell.pause, SetBool.Request(data=False)).success
    assert cell.result(handle).success
    assert_clean(cell)


def test_stop_ends_the_goal(cell, node):
    handle = start_motion(cell)
    assert cell.call(cell.stop, Trigger.Request()).success
    result = cell.result(handle)
    assert not result.success
    assert result.code == S.STOPPED
    assert "~/stop" in result.message
    assert_clean(cell)


def test_cancel_ends_the_goal_at_rest(cell, node):
    handle = start_motion(cell)
    handle.cancel_goal_async()
    result = cell.result(handle)
    assert result.code == S.STOPPED
    assert_clean(cell)


def test_a_new_goal_replaces_the_running_one_without_a_halt(cell, node):
    first = start_motion(cell)
    second = cell.send_goal(use_goal_pose=True, goal_pose=cell.pose_goal(shift(z=0.1)), duration=1.0)
    assert cell.result(second).success
    assert cell.result(first).code == S.STOPPED
    assert_clean(cell)


def test_stale_joint_states_stop_the_arm(cell, node):
    handle = start_motion(cell)
    cell.silent = True
    result = cell.result(handle)
    assert result.code == S.STALE_JOINTS
    assert "limit 0.1 s" in result.message
    assert_clean(cell)
    cell.silent = False
    time.sleep(0.3)
    again = cell.send_goal(use_goal_pose=True, goal_pose=cell.pose_goal(shift(z=0.05)), duration=1.0)
    assert cell.result(again).success
    assert_clean(cell)


def test_joint_states_with_old_stamps_are_stale(cell, node):
    cell.stamp_offset = -0.5
    time.sleep(0.3)
    result = cell.result(cell.send_goal(use_goal_pose=True, goal_pose=cell.pose_goal(shift(z=0.05))))
    assert result.code == S.STALE_JOINTS
    assert cell.commands == []


def test_a_blocked_arm_is_noticed(cell, node):
    handle = start_motion(cell)
    cell.blocked = True
    result = cell.result(handle)
    assert result.code == S.DRIVER_DEVIATION
    assert "off its setpoints" in result.message
    assert_clean(cell)


@pytest.mark.parametrize("how", ["nan", "unknown"])
def test_bad_joint_states_are_not_used(cell, node, how):
    handle = start_motion(cell)

    def corrupt(message):
        if how == "nan":
            message.position = [float("nan")] * len(message.position)
        else:
            message.name = [f"other_{n}" for n in message.name]

    cell.corrupt = corrupt
    assert cell.result(handle).code == S.STALE_JOINTS
    assert_clean(cell)
    _, output = node.end()
    assert ("not finite" if how == "nan" else "lacks pan") in output


def test_killed_and_restarted_it_neither_jumps_nor_moves(cell, node):
    start_motion(cell)
    node.kill()
    cell.wait_for_rest()
    count = len(cell.commands)
    held = cell.commands[-1]
    cell.statuses.clear()
    cell.status = None
    restarted = Positioner(DOMAIN)
    try:
        cell.wait_for_code(S.IDLE, 15)
        cell.wait(lambda: "at rest" in cell.status.message, 10, "robot_description")
        time.sleep(0.5)
        assert len(cell.commands) == count
        handle = cell.send_goal(use_goal_pose=True, goal_pose=cell.pose_goal(shift(z=0.05)), duration=1.0)
        assert cell.result(handle).success
        assert np.abs(cell.commands[count] - held).max() < 1e-4
        cell.commands = cell.commands[count:]
        assert_clean(cell)
    finally:
        restarted.end()


def test_sigterm_in_mid_motion_brings_the_arm_to_rest(cell, node):
    start_motion(cell)
    node.process.send_signal(signal.SIGTERM)
    code, output = node.end()
    assert code == 0, output
    assert_clean(cell)
    assert "shuts down" in cell.statuses[-1][1]
    assert cell.statuses[-1][0] == S.STOPPED
