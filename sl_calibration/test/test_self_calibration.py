"""Self-calibration: accuracy, and uncertainty that is what it says."""

import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from synthetic_views import QUICK, SIZE, calibrate, mahalanobis, make_cell, observe

from pattern_gen import Pattern
from sl_calibration.self_calibration.calibrate import SelfCalibrationOptions, self_calibrate
from sl_calibration.self_calibration.inputs import load_motion
from sl_calibration.self_calibration.views import View
from sl_common import transforms
from sl_common.cameras import CameraModel


@pytest.mark.parametrize(("seed", "lens_model"), [(1, "none"), (7, "pers"), (5, "plumb_bob")])
def test_truth_is_found_within_the_stated_uncertainty(seed, lens_model):
    cell = make_cell(seed, views=10, lens=lens_model)
    result = calibrate(cell, observe(cell, seed, wrong=0.02))
    hand_eye = transforms.difference(result.flange_from_camera, cell.flange_from_camera)
    projector = transforms.difference(result.base_from_projector, cell.base_from_projector)
    assert 1e3 * np.linalg.norm(hand_eye[:3]) < 0.8
    assert np.degrees(np.linalg.norm(hand_eye[3:])) < 0.05
    # chi-square with six degrees of freedom, 99.9 %: 22.5
    assert mahalanobis(hand_eye, result.hand_eye_covariance) < 22.5
    assert mahalanobis(projector, result.projector_pose_covariance) < 22.5
    k, truth = result.projector.matrix, cell.projector.matrix
    for name, i, j in (("fx", 0, 0), ("fy", 1, 1), ("cx", 0, 2), ("cy", 1, 2)):
        assert abs(k[i, j] - truth[i, j]) < 4 * result.projector_sigma[name]
        assert result.projector_sigma[name] < 3.0
    index = result.dots[:, 0] * cell.centers.shape[1] + result.dots[:, 1]
    error = np.linalg.norm(result.points - cell.points[index], axis=-1)
    assert 1e3 * np.sqrt(np.mean(error**2)) < 0.5
    assert result.noise.camera.mean() == pytest.approx(0.1, rel=0.15)
    assert result.rejected > 20


def test_more_noise_and_fewer_views_raise_the_stated_uncertainty():
    cell = make_cell(3, views=10, step=3)
    good = calibrate(cell, observe(cell, 3))
    few = calibrate(cell, observe(cell, 3)[:5])
    noisy = calibrate(cell, observe(cell, 3, position_sigma=5e-4, rotation_sigma=np.radians(0.1)))
    for worse in (few, noisy):
        assert np.trace(worse.hand_eye_covariance) > 1.3 * np.trace(good.hand_eye_covariance)
    assert noisy.noise.position > 2.5e-4  # estimated, although 0.1 mm was the prior


def test_distortion_of_the_projector_is_found_where_it_is_there():
    cell = make_cell(11, views=6, step=3, projector_lens=(-0.15, 0, 0, 0, 0))
    result = calibrate(cell, observe(cell, 11), SelfCalibrationOptions(left_out=False))
    assert result.projector.distortion_model == "plumb_bob"
    assert result.projector.coefficients[0] == pytest.approx(-0.15, abs=4 * result.projector_sigma["k1"])
    plain = make_cell(11, views=6, step=3)
    result = calibrate(plain, observe(plain, 11), SelfCalibrationOptions(left_out=False))
    assert result.projector.distortion_model == "none"


def test_camera_intrinsics_are_refined_on_request():
    cell = make_cell(4, views=10, step=3)
    truth = cell.camera
    wrong = CameraModel(640, 480, truth.matrix + np.array([[2.0, 0, 1.5], [0, 2.0, -1.0], [0, 0, 0]]))
    views = observe(cell, 4)
    result = self_calibrate(
        views, wrong, cell.centers, SIZE, SelfCalibrationOptions(left_out=False, refine_camera=True)
    )
    delta = np.abs(result.camera.matrix - truth.matrix)
    assert delta[0, 0] < min(4 * result.camera_sigma["fx"], 1.5)
    assert delta[0, 2] < min(4 * result.camera_sigma["cx"], 1.0)


def test_left_out_errors_are_those_of_the_robot_noise():
    cell = make_cell(6, views=8, step=3)
    result = calibrate(cell, observe(cell, 6), replace(QUICK, left_out=True))
    assert 0.1 < result.left_out.pixels < 1.0
    assert 5e-5 < result.left_out.position < 1e-3
    assert result.left_out.pixels > result.rms


@pytest.mark.skipif("SL_TEST_DATA" not in os.environ, reason="SL_TEST_DATA is not set: no rendered motion")
@pytest.mark.parametrize("count", [14, 8])
def test_rendered_motion_with_pixel_noise(count):
    folder = Path(os.environ["SL_TEST_DATA"]) / "rendered_motion"
    pattern = Pattern.load(folder.parent / "rendered" / "pattern.yaml")
    truth = json.loads((folder / "motion.json").read_text())["truth"]
    motion = load_motion(folder / "motion.json")
    rng = np.random.default_rng(0)
    views = []
    for i, image in enumerate(motion.images[:count]):
        with np.load(folder / "truth" / f"{Path(image).stem}.npz") as file:
            row, col = np.nonzero(file["visible"] & ~file["edge"])
            pixels = file["xy"][row, col] + rng.normal(scale=0.1, size=(len(row), 2))
        wrong = rng.random(len(row)) < 0.01
        row[wrong], col[wrong] = rng.integers(0, 44, wrong.sum()), rng.integers(0, 58, wrong.sum())
        views.append(View(Path(image).stem, row, col, pixels, motion.base_from_flange[i]))
    options = replace(QUICK, spot_diameter=pattern.spot_diameter)
    result = self_calibrate(views, motion.camera, pattern.centers, SIZE, options)
    hand_eye = transforms.difference(np.array(truth["flange_from_camera"]), result.flange_from_camera)
    projector = transforms.difference(np.array(truth["base_from_projector"]), result.base_from_projector)
    k = truth["projector"]
    focal = result.projector.matrix[0, 0] / k["fx"] - 1
    centre = np.hypot(result.projector.matrix[0, 2] - k["cx"], result.projector.matrix[1, 2] - k["cy"])
    assert mahalanobis(hand_eye, result.hand_eye_covariance) < 12.6
    assert mahalanobis(projector, result.projector_pose_covariance) < 12.6
    assert 1e3 * np.linalg.norm(hand_eye[:3]) < 0.8
    assert np.degrees(np.linalg.norm(hand_eye[3:])) < 0.03
    assert 1e3 * np.linalg.norm(projector[:3]) < 1.2
    assert np.degrees(np.linalg.norm(projector[3:])) < 0.03
    assert abs(focal) < 5e-4
    assert centre < 1.0
