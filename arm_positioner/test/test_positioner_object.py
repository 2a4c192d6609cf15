"""In front of an object seen in a point cloud, over DDS: once, followed, lost, with calibrations that change."""

import os
import time

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("sl_msgs")
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

from positioner_cell import Cell, Positioner, own_domain
from positioner_robots import HOME
from std_srvs.srv import Trigger

from sl_common import transforms
from sl_common.calibration_files import HAND_EYE_FILE, HAND_EYE_KEY, PoseCalibration, save_pose
from sl_msgs.msg import PositionerStatus as S

pytestmark = pytest.mark.processes
DOMAIN = own_domain(44)
FLANGE_FROM_CAMERA = transforms.make(transforms.rotation_exp((0.05, -0.1, 0.3)), (0.02, -0.05, 0.04))


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibration")
    cell = Cell("six", DOMAIN)
    node = Positioner(DOMAIN, calibration_folder=str(folder), standoff=0.35, cloud_timeout=1.0, lost_timeout=1.5)
    cell.wait_for_code(S.IDLE, 20)
    cell.wait(lambda: "at rest" in cell.status.message, 20, "robot_description")
    yield cell, node, folder
    code, output = node.end()
    cell.close()
    assert code == 0, output


@pytest.fixture
def cell(shared):
    cell, _, folder = shared
    shown = cell.scene is not None
    cell.reset()
    if shown:
        time.sleep(1.1)  # clouds of the board where another test left it count no longer
    cell.cloud_frame = "base_link"
    if not (folder / HAND_EYE_FILE).exists():
        save_pose(folder / HAND_EYE_FILE, HAND_EYE_KEY, PoseCalibration(FLANGE_FROM_CAMERA))
        # no wait: a goal uses what is there when it comes
    return cell


def camera(cell, q=None):
    return cell.arm.forward(cell.q if q is None else q) @ FLANGE_FROM_CAMERA


class Board:
    """A tilted square of dots 0.45 m in front of the camera's first pose, and a wall behind; it may travel."""

    def __init__(self, noise=3e-4):
        self.first = None
        self.noise = noise
        self.velocity = np.zeros(3)
        self.begun = None
        self.shown = True
        self.rng = np.random.default_rng(0)

    def place(self, cell):
        self.first = camera(cell, HOME["six"])
        self.first_from_board = transforms.make(transforms.rotation_exp((0.25, 0.15, 0)), (0.02, -0.03, 0.45))
        return self

    def pose(self, now):
        travelled = self.velocity * (now - self.begun) if self.begun else np.zeros(3)
        moved = transforms.make(np.eye(3), travelled)
        return moved @ self.first @ self.first_from_board

    @property
    def normal(self):
        return -(self.first @ self.first_from_board)[:3, 2]

    def __call__(self, now):
        row, col = (a.ravel() for a in np.mgrid[0:18, 0:18])
        board = np.stack(
            [0.009 * (col - 8.5), 0.009 * (row - 8.5), self.noise * self.rng.normal(size=row.size)], axis=1
        )
        wall = np.stack([0.02 * (col - 8.5), 0.02 * (row - 8.5), np.full(row.size, 0.9)], axis=1)
        points = transforms.apply(self.first, wall)
        rows, cols = row + 40, col
        if self.shown:
            points = np.vstack([transforms.apply(self.pose(now), board), points])
            rows, cols = np.append(row, rows), np.append(col, cols)
        return points, rows, cols


def test_it_stands_off_along_the_normal_and_looks_at_the_object(cell):
    cell.scene = board = Board().place(cell)
    result = cell.result(cell.send_goal(duration=2.0, standoff=0.3), 15)
    assert result.success, result.message
    pose = camera(cell)
    centre = board.pose(0)[:3, 3]
    assert np.linalg.norm(pose[:3, 3] - centre - 0.3 * board.normal) < 0.012  # within a dot's spacing along the surface
    assert abs((pose[:3, 3] - centre) @ board.normal - 0.3) < 1e-3
    assert np.degrees(np.arccos(-pose[:3, 2] @ board.normal)) < 0.5
    assert result.position_error < 1e-3
    cell.wait_for_rest()
    assert cell.violations() == []


def test_clouds_in_the_camera_frame_serve_as_well(cell):
    board = Board().place(cell)

    def seen(now):
        points, row, col = board(now)
        return transforms.apply(transforms.inverse(camera(cell)), points), row, col

    result = cell.result(cell.send_goal(use_goal_pose=True, goal_pose=cell.pose_message(board.first)), 15)
    assert result.success, result.message
    cell.cloud_frame, cell.scene = "camera_optical_frame", seen
    result = cell.result(cell.send_goal(duration=2.0), 15)
    assert result.success, result.message
    assert abs((camera(cell)[:3, 3] - board.pose(0)[:3, 3]) @ board.normal - 0.35) < 5e-3
    cell.wait_for_rest()
    assert cell.violations() == []


def test_a_moving_object_is_followed_until_cancelled(cell):
    cell.scene = board = Board().place(cell)
    assert cell.result(cell.send_goal(duration=1.5), 15).success
    handle = cell.send_goal(follow=True)
    cell.wait_for_code(S.FOLLOWING)
    board.velocity, board.begun = board.first[:3, 0] * 0.04, time.monotonic()
    errors = []
    while time.monotonic() < board.begun + 4.0:
        time.sleep(0.05)
        wanted = board.pose(time.monotonic())[:3, 3] + 0.35 * board.normal
        errors.append(np.linalg.norm(camera(cell)[:3, 3] - wanted))
    assert cell.status.code == S.FOLLOWING, cell.status.message
    assert np.median(errors[-25:]) < 0.04 * 0.6  # at most 0.6 s behind, at ten clouds a second
    handle.cancel_goal_async()
    assert cell.result(handle).code == S.STOPPED
    cell.wait_for_rest()
    assert cell.violations() == []


def test_a_lost_object_holds_the_arm_then_ends_the_goal(cell):
    cell.scene = board = Board().place(cell)
    handle = cell.send_goal(follow=True, duration=3.0)
    cell.wait(lambda: len(cell.commands) > 60, 6, "motion")
    cell.scene = None
    message = cell.wait_for_code(S.LOST_CLOUD)
    assert "limit 1 s" in message
    cell.wait_for_rest()
    cell.scene = board
    cell.wait_for_code(S.FOLLOWING)
    cell.scene = None
    result = cell.result(handle, 15)
    assert result.code == S.LOST_CLOUD
    assert "given up after 1.5 s" in result.message
    cell.wait_for_rest()
    assert cell.violations() == []


def test_a_goal_that_waits_for_a_cloud_does_not_begin_after_a_stop(cell):
    handle = cell.send_goal(duration=1.0)
    time.sleep(0.5)  # it waits
    assert cell.call(cell.stop, Trigger.Request()).success
    cell.scene = Board().place(cell)
    result = cell.result(handle, 15)
    assert result.code == S.STOPPED
    assert "~/stop came first" in result.message
    assert cell.commands == []


def test_of_two_goals_at_once_the_newer_one_moves_the_arm(cell):
    older = cell.send_goal(duration=1.0, standoff=0.25)
    time.sleep(0.2)
    newer = cell.send_goal(duration=1.0, standoff=0.35)
    cell.scene = board = Board().place(cell)
    assert cell.result(older, 15).code == S.STOPPED
    result = cell.result(newer, 15)
    assert result.success, result.message
    assert abs((camera(cell)[:3, 3] - board.pose(0)[:3, 3]) @ board.normal - 0.35) < 2e-3
    assert "surface normal known to 0." in result.message
    cell.wait_for_rest()
    assert cell.violations() == []


@pytest.mark.parametrize("what", ["none", "frame", "few", "nan"])
def test_clouds_that_cannot_be_used_are_named_and_nothing_moves(cell, what):
    board = Board().place(cell)
    if what == "frame":
        cell.cloud_frame, cell.scene = "map", board
    elif what == "few":
        cell.scene = lambda now: tuple(a[:5] for a in board(now))
    elif what == "nan":
        cell.scene = lambda now: (board(now)[0] * np.nan, *board(now)[1:])
    result = cell.result(cell.send_goal(), 15)
    assert not result.success
    assert result.code == (S.INVALID_INPUT if what == "frame" else S.LOST_CLOUD)
    said = {
        "none": "point cloud on /points",
        "frame": "point cloud in frame 'map', expected 'base_link'",
        "few": "5 usable points of 5",
        "nan": "0 usable points of",
    }[what]
    assert said in result.message
    assert cell.commands == []


def test_a_broken_calibration_file_leaves_the_last_good_one_in_use(cell, shared):
    _, node, folder = shared
    (folder / HAND_EYE_FILE).write_text("flange_from_camera: [[1, 0], [0, 1]]\n")
    time.sleep(1.5)
    cell.scene = Board().place(cell)
    assert cell.result(cell.send_goal(duration=1.0), 15).success  # the last good one stays in use
    assert "hand-eye calibration not used, the last good one stays" in node.output
    save_pose(folder / HAND_EYE_FILE, HAND_EYE_KEY, PoseCalibration(FLANGE_FROM_CAMERA))
    time.sleep(1.5)
    assert "hand-eye calibration read" in node.output
