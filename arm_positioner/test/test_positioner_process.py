"""What the node does when it starts, is killed, is ended, or is given wrong parameters."""

import os
import signal
import time

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("sl_msgs")
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

from positioner_cell import PERIOD, Cell, Positioner, own_domain
from positioner_robots import HOME

from sl_common import transforms
from sl_msgs.msg import PositionerStatus as S

pytestmark = pytest.mark.processes
DOMAIN = own_domain(42)


@pytest.fixture
def cell():
    it = Cell("six", DOMAIN)
    yield it
    it.close()


@pytest.fixture
def launch():
    """Start nodes that are gone after the test, whatever becomes of it."""
    nodes = []

    def start(**parameters):
        nodes.append(Positioner(DOMAIN, **parameters))
        return nodes[-1]

    yield start
    for node in nodes:
        node.end()


def start(launch, cell, **parameters):
    node = launch(**parameters)
    cell.status = None
    cell.wait(lambda: cell.status is not None and "at rest" in cell.status.message, 20, "robot_description")
    time.sleep(0.3)
    return node


def shifted(cell, x=0.0, z=0.0):
    return cell.pose_goal(transforms.make(np.eye(3), (x, 0.0, z)))


def under_way(cell):
    handle = cell.send_goal(use_goal_pose=True, goal_pose=shifted(cell, x=0.25), duration=3.0)
    cell.wait(lambda: len(cell.commands) > 100 or cell.trajectories, 6, "motion")
    return handle


def test_nothing_moves_on_start_up_nor_after_being_killed_in_mid_motion(launch, cell):
    node = start(launch, cell)
    time.sleep(0.5)
    assert cell.commands == []
    under_way(cell)
    node.kill()
    cell.wait_for_rest()
    count, held = len(cell.commands), cell.commands[-1]
    node = start(launch, cell)
    time.sleep(0.5)
    assert len(cell.commands) == count
    result = cell.result(cell.send_goal(use_goal_pose=True, goal_pose=shifted(cell, z=0.05), duration=1.0))
    assert result.success, result.message
    assert np.abs(cell.commands[count] - held).max() < 1e-4  # it goes on from where the driver was left
    cell.commands = cell.commands[count:]
    cell.wait_for_rest()
    assert cell.violations() == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_in_mid_motion_brings_the_arm_to_rest_and_ends_with_0(launch, cell, number):
    node = start(launch, cell)
    under_way(cell)
    node.process.send_signal(number)
    code, output = node.end()
    assert code == 0, output
    cell.wait_for_rest()
    assert cell.violations() == []
    assert cell.statuses[-1][0] == S.STOPPED
    assert "shuts down" in cell.statuses[-1][1]


def test_joints_are_sent_in_the_order_of_the_parameter(launch):
    order = ["wrist_c", "pan", "elbow", "lift", "wrist_b", "wrist_a"]
    cell = Cell("six", DOMAIN, command_order=order)
    node = start(launch, cell, joints="[" + ",".join(order) + "]")
    try:
        goal = shifted(cell, z=0.05)
        result = cell.result(cell.send_goal(use_goal_pose=True, goal_pose=goal, duration=1.0))
        assert result.success, result.message
        assert np.allclose(cell.commands[0], HOME["six"], atol=1e-4)
        assert cell.violations() == []
    finally:
        node.end()
        cell.close()


def test_joint_trajectories_end_at_rest_continue_each_other_and_outlive_the_node(launch, cell):
    node = start(launch, cell, command_interface="joint_trajectory")
    handle = cell.send_goal(use_goal_pose=True, goal_pose=shifted(cell, x=0.1), duration=2.0)
    result = cell.result(handle)
    assert result.success, result.message
    finished = len(cell.trajectories)
    assert finished > 10
    under_way(cell)
    cell.wait(lambda: len(cell.trajectories) > finished + 10, 5, "motion")
    node.kill()
    time.sleep(0.1)
    executed = []
    tail = None
    for message in cell.trajectories:
        assert message.joint_names == cell.names
        points = message.points
        assert np.allclose(points[-1].velocities, 0)
        assert np.allclose(points[-1].accelerations, 0)
        begin = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        positions = np.array([p.positions for p in points])
        if tail is not None and begin < tail[0][-1]:
            # where a message replaces the one before, both lie on the same time grid and agree at the seam
            k = int(np.argmin(np.abs(tail[0] - begin)))
            assert abs(tail[0][k] - begin) < 1e-6
            executed = executed[: len(executed) - (len(tail[0]) - k)]
        executed += list(positions)
        tail = (begin + PERIOD * np.arange(len(points)), positions)
    cell.commands = executed
    assert cell.violations() == []


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"rate": "fast"}, "parameter rate is 'fast'"),
        ({"rate": 2000.0}, "parameter rate is 2000, expected at least 10 and at most 1000"),
        ({"command_interface": "servo"}, "expected one of forward_position, joint_trajectory"),
        ({"condition_slow": 200.0}, "condition_slow 200 must be below condition_stop 100"),
        ({"standoff": -1.0}, "parameter standoff is -1"),
    ],
)
def test_a_wrong_parameter_ends_the_node_with_one_line_and_1(launch, parameters, said):
    node = launch(**parameters)
    node.process.wait(timeout=20)
    code, output = node.end()
    assert code == 1
    assert said in output
    assert "Traceback" not in output


def test_wrong_joints_or_limits_are_said_and_nothing_is_served(launch, cell):
    node = launch(joints="[pan,lift]")
    try:
        cell.wait(lambda: "parameter joints is pan, lift" in node.output, 20, "the message")
        result = cell.result(cell.send_goal(use_goal_pose=True, goal_pose=shifted(cell)))
        assert result.code == S.INVALID_INPUT
        assert "robot_description" in result.message
    finally:
        assert node.end()[0] == 0


def test_it_says_what_it_waits_for(launch):
    node = launch()
    end = time.monotonic() + 20
    while "robot_description (std_msgs/msg/String" not in node.output and time.monotonic() < end:
        time.sleep(0.1)
    code, output = node.end()
    assert code == 0
    assert "waiting for /robot_description (std_msgs/msg/String; reliable, transient local, depth 1)" in output
    assert "waiting for /joint_states (sensor_msgs/msg/JointState" in output
