"""Camera calibration: recovery of known truth within the stated uncertainty, choice of the model, refusals, real
images."""

import os
from functools import cache
from pathlib import Path

import board_scenes
import cv2
import numpy as np
import pytest
import yaml

from sl_calibration.board_bundle import BundleError, OddViewError
from sl_calibration.camera_calibration import CameraOptions, calibrate_camera, rms, same_views
from sl_calibration.commands.calibrate_camera import main
from sl_common import transforms
from sl_common.calibration_files import load_camera
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError

WIDE = np.array([[480.0, 0, 395], [0, 480.0, 305], [0, 0, 1]])
CAMERAS = {
    "none": CameraModel(800, 600, WIDE),
    "pers_tied": CameraModel(800, 600, WIDE, "pers", (1.0,)),
    "pers_free": CameraModel(800, 600, WIDE, "pers", (0.62,)),
    "plumb_bob": CameraModel(800, 600, WIDE, "plumb_bob", (-0.28, 0.09, 0.002, -0.0015, -0.012)),
}


def views(camera, number=10, noise=0.1, seed=0):
    truth = board_scenes.poses(number, distance=0.42, tilt=0.6, seed=seed)
    return board_scenes.corners_of(camera, truth, noise=noise, seed=seed + 9)


@pytest.mark.parametrize("name", list(CAMERAS))
def test_recovers_each_lens_within_its_uncertainty(name):
    truth = CAMERAS[name]
    result = calibrate_camera(views(truth), board_scenes.BOARD, 800, 600, CameraOptions(name))
    expected = {"fx": 480, "fy": 480, "cx": 395, "cy": 305}
    if name == "pers_free":
        expected["pers_f"] = 0.62
    for key, value in expected.items():
        entry = result.parameters[key]
        assert abs(entry["value"] - value) < 3 * entry["sigma"], key
        assert entry["sigma"] < 0.02 * 480
    assert rms(result.residuals) == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
    assert result.left_out.max() < 0.25


@pytest.mark.parametrize(
    ("name", "right"), [("none", {"none"}), ("pers_free", {"pers_free"}), ("plumb_bob", {"plumb_bob"})]
)
def test_chooses_the_lens_by_the_views_left_out(name, right):
    result = calibrate_camera(views(CAMERAS[name], seed=4), board_scenes.BOARD, 800, 600)
    assert result.parametrisation.model in right
    assert set(result.candidates) == {"none", "pers_tied", "pers_free", "plumb_bob"}
    best = min(left_out for _, left_out in result.candidates.values())
    assert result.candidates[result.parametrisation.model][1] < 1.02 * best


def test_telescopic_camera_off_centre():
    camera = CameraModel(1280, 1024, np.array([[3400.0, 0, 600], [0, 3400, 540], [0, 0, 1]]))
    corners = board_scenes.corners_of(camera, board_scenes.poses(8, distance=1.6, tilt=0.6, seed=2), noise=0.1)
    result = calibrate_camera(corners, board_scenes.BOARD, 1280, 1024, CameraOptions("none"))
    assert abs(result.parameters["fx"]["value"] - 3400) < 3 * result.parameters["fx"]["sigma"]
    assert abs(result.camera.matrix[0, 0] - 3400) < 40


def test_single_misread_corners_are_left_out():
    corners = views(CAMERAS["plumb_bob"])
    corners[3, 10] += (6, -5)
    corners[7, 40] += (-9, 2)
    result = calibrate_camera(corners, board_scenes.BOARD, 800, 600, CameraOptions("plumb_bob"))
    assert result.rejected >= 2
    assert np.isnan(result.residuals[3, 10]).all()
    assert np.isnan(result.residuals[7, 40]).all()
    assert abs(result.camera.matrix[0, 0] - 480) < 2


def test_too_few_views():
    with pytest.raises(InvalidInputError, match="too few views: 2"):
        calibrate_camera(views(CAMERAS["none"], number=2), board_scenes.BOARD, 800, 600)


def test_views_that_leave_the_focal_length_open_are_refused():
    level = np.array(
        [transforms.make(np.eye(3), (x, y, 0.9)) for x, y in ((-0.2, -0.1), (-0.1, -0.15), (-0.25, -0.05))]
    )
    corners = board_scenes.corners_of(CAMERAS["none"], level, noise=0.1)
    with pytest.raises(BundleError, match=r"do not determine the camera: focal length .*; tilt the board"):
        calibrate_camera(corners, board_scenes.BOARD, 800, 600, CameraOptions("none"))


def test_the_same_view_again_is_told_from_a_different_one():
    different = views(CAMERAS["none"], number=4)
    corners = np.concatenate([different, different[[2, 0]] + 0.2, different[:1]])
    assert same_views(corners) == {4: 2, 5: 0, 6: 0}
    corners[2, :40] = np.nan  # partly seen, at the same place
    assert same_views(corners) == {4: 2, 5: 0, 6: 0}
    assert same_views(different) == {}


def test_a_view_of_another_camera_is_named():
    corners = views(CAMERAS["none"], number=6)
    corners[4] = (corners[4] - (395, 305)) * (1.0, 1.12) + (395, 305) + 0.02 * (corners[4] - 300)[:, ::-1] ** 2 / 100
    with pytest.raises(OddViewError, match="view 5 does not fit the others"):
        calibrate_camera(corners, board_scenes.BOARD, 800, 600)


@cache
def photographs(number: int) -> list[np.ndarray]:
    camera = CameraModel(800, 600, np.array([[900.0, 0, 400], [0, 900.0, 300], [0, 0, 1]]))
    poses = board_scenes.poses(number, seed=7)
    return [(230 * board_scenes.board_albedo(camera, pose, board_scenes.BOARD)).astype(np.uint8) for pose in poses]


def write_photographs(folder: Path, number: int) -> list[str]:
    paths = [str(folder / f"photo_{k}.png") for k in range(number)]
    for path, image in zip(paths, photographs(number), strict=True):
        cv2.imwrite(path, image)
    return paths


def test_command_writes_the_file_and_says_what_it_found(tmp_path, capsys):
    output = tmp_path / "camera.yaml"
    paths = write_photographs(tmp_path, 5)
    assert main(["--board", "9x7", "--square", "0.04", "--model", "none", "--output", str(output), *paths]) == 0
    text = capsys.readouterr().out
    assert "training" in text
    assert "left-out" in text
    assert "worst view: photo_" in text
    assert load_camera(output).matrix[0, 0] == pytest.approx(900, rel=0.01)
    data = yaml.safe_load(output.read_text())
    assert data["samples"] == 5
    assert {"date", "units", "residuals", "uncertainty_one_sigma"} <= set(data)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"--board": "8x6"}, "wrong board size: --board 8x6 is in 0 of 3 images, but 3 show 9x7"),
        ({"--square": "40"}, "mixed units"),
        ({"few": "2"}, "too few views: 2"),
        ({"same": "2"}, "too few views: 1"),
        ({"size": "swap"}, "must come from one camera"),
        ({"missing": "1"}, "no such file"),
    ],
)
def test_command_refuses_and_writes_nothing(tmp_path, capsys, change, message):
    options = {"--board": "9x7", "--square": "0.04"} | {k: v for k, v in change.items() if k.startswith("--")}
    paths = write_photographs(tmp_path, 3)
    if "few" in change:
        paths = paths[:2]
    if "same" in change:
        paths = [paths[0]] * 3
    if "missing" in change:
        paths[1] = str(tmp_path / "none.png")
    if "size" in change:
        cv2.imwrite(paths[2], cv2.resize(cv2.imread(paths[2]), (640, 480)))
    output = tmp_path / "camera.yaml"
    arguments = [part for pair in options.items() for part in pair]
    assert main([*arguments, "--model", "none", "--output", str(output), *paths]) == 1
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("error: ")
    assert message in error
    assert not output.exists()


@pytest.mark.skipif("SL_TEST_DATA" not in os.environ, reason="SL_TEST_DATA is not set")
def test_real_wide_angle_camera(tmp_path, capsys):
    images = sorted((Path(os.environ["SL_TEST_DATA"]) / "gopro_wide" / "calibration_wide").glob("*.jpg"))
    output = tmp_path / "gopro.yaml"
    assert main(["--board", "8x6", "--square", "0.03", "--output", str(output), *map(str, images)]) == 0
    lines = capsys.readouterr().out.splitlines()
    training = {line.split()[1]: float(line.split()[3]) for line in lines if line.startswith("model ")}
    left_out = {line.split()[1]: float(line.split()[6]) for line in lines if line.startswith("model ")}
    assert int(lines[0].split()[0]) >= 34
    assert training["pers_free"] <= 1.39
    assert training["pers_tied"] <= 3.45
    assert training["plumb_bob"] <= 1.32
    assert next(line for line in lines if line.endswith("<- chosen")).split()[1] == min(left_out, key=left_out.get)
