import numpy as np
import pytest
import yaml

from sl_common import transforms
from sl_common.calibration_files import (
    HAND_EYE_KEY,
    PoseCalibration,
    load_calibration,
    load_camera,
    load_pose,
    save_camera,
    save_pose,
)
from sl_common.cameras import CameraModel
from sl_common.errors import CalibrationFileError
from sl_common.files import atomic_path

MATRIX = np.array([[820.0, 0.0, 325.3], [0.0, 815.0, 236.8], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("model", "coefficients"), [("none", ()), ("pers", (0.9,)), ("plumb_bob", (-0.3, 0.1, 0.001, 0.0, 0.0))]
)
def test_camera_round_trip_keeps_the_model(tmp_path, model, coefficients):
    camera = CameraModel(640, 480, MATRIX, model, coefficients)
    save_camera(tmp_path / "camera.yaml", camera, name="left", extra={"samples": 4})
    read = load_camera(tmp_path / "camera.yaml")
    assert (read.distortion_model, read.coefficients) == (model, camera.coefficients)
    assert np.array_equal(read.matrix, camera.matrix)
    data = yaml.safe_load((tmp_path / "camera.yaml").read_text())
    assert data["distortion_model"] == "plumb_bob", "what other ROS tools read"
    assert data["samples"] == 4


def test_pose_round_trip(tmp_path):
    pose = PoseCalibration(transforms.exp([0.1, 0.2, 0.3, 0.4, -0.5, 0.6]), np.diag(np.arange(6.0)), {"samples": 14})
    save_pose(tmp_path / "hand_eye.yaml", HAND_EYE_KEY, pose)
    read = load_pose(tmp_path / "hand_eye.yaml", HAND_EYE_KEY)
    assert np.array_equal(read.transform, pose.transform)
    assert np.array_equal(read.covariance, pose.covariance)
    assert read.extra == {"samples": 14}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (None, "no such file"),
        ("a: 1\n\tb: 2", "line 2: not valid YAML"),
        ("- 1", "expected a mapping"),
        ("image_width: 3", "key 'camera_matrix' is missing"),
        ("{image_width: x, image_height: 2, camera_matrix: {data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}", "invalid literal"),
        ("{image_width: 2, image_height: 2, camera_matrix: {data: [1, 0, 0]}}", "3 numbers, expected 3x3"),
    ],
)
def test_unusable_camera_files_are_refused_by_name(tmp_path, text, reason):
    path = tmp_path / "camera.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(CalibrationFileError, match=reason) as error:
        load_camera(path)
    assert str(path) in str(error.value)


def test_a_matrix_that_is_not_rigid_is_refused(tmp_path):
    path = tmp_path / "hand_eye.yaml"
    path.write_text(yaml.safe_dump({HAND_EYE_KEY: (2 * np.eye(4)).tolist()}))
    with pytest.raises(CalibrationFileError, match="not a rigid 4x4"):
        load_pose(path, HAND_EYE_KEY)
    with pytest.raises(CalibrationFileError, match="key 'base_from_projector' is missing"):
        load_pose(path, "base_from_projector")


def test_a_folder_lacking_a_file_names_it(tmp_path):
    save_camera(tmp_path / "camera.yaml", CameraModel(640, 480, MATRIX))
    with pytest.raises(CalibrationFileError, match=r"projector\.yaml: no such file"):
        load_calibration(tmp_path)


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "camera.yaml"
    path.write_text("old")

    def fail():
        with atomic_path(path) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
