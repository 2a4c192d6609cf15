"""Pairing by stamp when the clock is set back."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")
pytest.importorskip("sl_msgs")

from geometry_msgs.msg import PoseStamped
from positioner_robots import HOME, kinematics

from arm_positioner.ros.scene import Scene
from arm_positioner.watchdog import WatchOptions
from sl_common import transforms
from sl_common.joint_buffer import JointLookupError
from sl_common.ros.stamps import from_ns

SECOND = 1_000_000_000


@pytest.fixture
def scene():
    settings = SimpleNamespace(
        follow_smoothing=0.15, watch=WatchOptions(), base_frame="base_link", camera_frame="camera_optical_frame"
    )
    hand_eye = SimpleNamespace(flange_from_camera=transforms.identity(), projector=None, problem="")
    it = Scene(SimpleNamespace(), settings, hand_eye, SimpleNamespace())
    it.attach(kinematics("six"), None)
    yield it
    it.close()


def camera_at(scene, stamp):
    goal = PoseStamped()
    goal.header.frame_id, goal.header.stamp = "camera_optical_frame", from_ns(stamp)
    goal.pose.orientation.w = 1.0
    return scene.base_from_goal(goal)


def play(scene, begin, positions):
    for k in range(100):
        scene.add_joints(begin + k * SECOND // 100, positions)


def test_after_a_jump_back_nothing_is_paired_with_the_motion_of_before(scene):
    before, after = HOME["six"], HOME["six"] + 0.3
    play(scene, 100 * SECOND, before)
    play(scene, 98 * SECOND, after)  # less than the buffer's length back: a bag played again from a little earlier
    assert np.allclose(camera_at(scene, 98 * SECOND + SECOND // 2), kinematics("six").forward(after))
    with pytest.raises(JointLookupError):
        camera_at(scene, 100 * SECOND + SECOND // 2)


def test_a_late_joint_state_is_put_in_its_place(scene):
    play(scene, 100 * SECOND, HOME["six"])
    scene.add_joints(100 * SECOND + 895 * SECOND // 1000, HOME["six"])
    assert np.allclose(camera_at(scene, 100 * SECOND + SECOND // 2), kinematics("six").forward(HOME["six"]))
