import os

import numpy as np

from arm_positioner.hand_eye import HandEye
from sl_common import transforms
from sl_common.calibration_files import (
    HAND_EYE_FILE,
    HAND_EYE_KEY,
    PROJECTOR_POSE_FILE,
    PROJECTOR_POSE_KEY,
    PoseCalibration,
    save_pose,
)

POSE = transforms.make(transforms.rotation_exp((0.1, 0.2, 0.3)), (0.01, 0.02, 0.03))


def save(folder, pose, tick):
    save_pose(folder / HAND_EYE_FILE, HAND_EYE_KEY, PoseCalibration(pose))
    os.utime(folder / HAND_EYE_FILE, (tick, tick))


def test_no_folder_is_the_identity_and_says_so():
    hand_eye = HandEye("")
    assert "calibration_folder" in hand_eye.problem
    assert np.array_equal(hand_eye.flange_from_camera, np.eye(4))
    assert hand_eye.refresh() == ""


def test_a_file_that_appears_is_read_and_a_changed_one_again(tmp_path):
    hand_eye = HandEye(str(tmp_path))
    assert "does not exist" in hand_eye.problem
    save(tmp_path, POSE, 100)
    assert "read from" in hand_eye.refresh()
    assert hand_eye.problem == ""
    assert np.allclose(hand_eye.flange_from_camera, POSE)
    assert hand_eye.refresh() == ""
    save(tmp_path, transforms.inverse(POSE), 200)
    assert "read from" in hand_eye.refresh()
    assert np.allclose(hand_eye.flange_from_camera, transforms.inverse(POSE))


def test_a_broken_or_missing_file_leaves_the_last_good_one(tmp_path):
    save(tmp_path, POSE, 100)
    hand_eye = HandEye(str(tmp_path))
    (tmp_path / HAND_EYE_FILE).write_text("flange_from_camera: 3\n")
    assert "the last good one stays" in hand_eye.refresh()
    assert hand_eye.refresh() == ""
    (tmp_path / HAND_EYE_FILE).unlink()
    assert hand_eye.refresh() == ""
    assert np.allclose(hand_eye.flange_from_camera, POSE)
    assert hand_eye.problem == ""


def test_a_broken_first_file_is_named(tmp_path):
    (tmp_path / HAND_EYE_FILE).write_text("something: 3\n")
    assert "key 'flange_from_camera' is missing" in HandEye(str(tmp_path)).problem


def test_the_projector_is_known_once_its_pose_is_written(tmp_path):
    save(tmp_path, POSE, 100)
    hand_eye = HandEye(str(tmp_path))
    assert hand_eye.projector is None
    save_pose(tmp_path / PROJECTOR_POSE_FILE, PROJECTOR_POSE_KEY, PoseCalibration(POSE))
    assert "read from" in hand_eye.refresh()
    assert np.allclose(hand_eye.projector, POSE[:3, 3])
    (tmp_path / PROJECTOR_POSE_FILE).write_text("base_from_projector: 3\n")
    hand_eye.refresh()
    assert np.allclose(hand_eye.projector, POSE[:3, 3])
