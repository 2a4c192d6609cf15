import json
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from synthetic_views import SIZE, make_cell, observe

from pattern_gen import Pattern, default_pattern
from sl_calibration.commands.self_calibrate import main
from sl_calibration.self_calibration import centroids, lens
from sl_calibration.self_calibration.calibrate import SelfCalibrationOptions, self_calibrate
from sl_calibration.self_calibration.errors import (
    DegenerateMotionError,
    DegenerateSceneError,
    InconsistentPosesError,
    TooFewViewsError,
)
from sl_calibration.self_calibration.inputs import load_motion, load_views
from sl_calibration.self_calibration.noise_model import correlation_inflation
from sl_calibration.self_calibration.views import View, flatten
from sl_common import calibration_files, transforms
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError

QUICK = SelfCalibrationOptions(left_out=False, projector_distortion=False)


def calibrate(cell, views, options=QUICK):
    return self_calibrate(views, cell.camera, cell.centers, SIZE, options)


def with_pose(view, pose):
    return replace(view, base_from_flange=pose)


def mahalanobis(delta, covariance):
    return float(delta @ np.linalg.solve(covariance, delta))


# The lens models and their derivatives


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("none", ()), ("pers", (0.9,)), ("plumb_bob", (-0.3, 0.1, 2e-3, -1e-3, 0.02))],
)
def test_projection_agrees_with_the_camera_model_and_its_derivatives_with_differences(model, coefficients):
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.4, 0.4, (40, 2)), rng.uniform(0.8, 1.2, 40)])
    points[0, :2] = 0.0  # on the axis, where the formulas have their limits
    camera = CameraModel(640, 480, np.array([[700.0, 0, 310], [0, 720, 250], [0, 0, 1]]), model, coefficients)
    vector = lens.parameters(camera)
    pixels, by_points, by_parameters = lens.project(model, vector, points)
    np.testing.assert_allclose(pixels, camera.project(points), atol=1e-9)
    step = 1e-6
    for k in range(3):
        d = np.eye(3)[k] * step
        slope = (lens.project(model, vector, points + d)[0] - lens.project(model, vector, points - d)[0]) / (2 * step)
        np.testing.assert_allclose(by_points[:, :, k], slope, atol=2e-5, rtol=1e-6)
    for k in range(len(vector)):
        d = np.eye(len(vector))[k] * step
        slope = (lens.project(model, vector + d, points)[0] - lens.project(model, vector - d, points)[0]) / (2 * step)
        np.testing.assert_allclose(by_parameters[:, :, k], slope, atol=2e-5, rtol=1e-6)
    assert lens.with_parameters(camera, vector).coefficients == camera.coefficients


# Accuracy and honesty


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


# Bad input: each condition by its name


def test_too_few_views():
    cell = make_cell(1, views=2)
    with pytest.raises(TooFewViewsError, match="2 usable views, at least 3"):
        calibrate(cell, observe(cell, 1))


def test_pure_translation():
    cell = make_cell(2, views=8, motion="translation")
    with pytest.raises(DegenerateMotionError, match=r"pure translation.*two different axes"):
        calibrate(cell, observe(cell, 2))


def test_rotation_about_one_axis_only():
    cell = make_cell(3, views=8, motion="axis")
    with pytest.raises(DegenerateMotionError, match=r"one axis of rotation.*across it"):
        calibrate(cell, observe(cell, 3, rotation_sigma=1e-5))


def test_flat_scene():
    cell = make_cell(4, views=6, relief=0.0, step=4)
    with pytest.raises(DegenerateSceneError, match=r"one plane.*different height"):
        calibrate(cell, observe(cell, 4))


def test_shuffled_poses():
    cell = make_cell(5, views=8)
    views = observe(cell, 5)
    order = [3, 6, 0, 7, 1, 2, 5, 4]
    with pytest.raises(InconsistentPosesError, match="shuffled"):
        calibrate(cell, [with_pose(v, views[i].base_from_flange) for v, i in zip(views, order, strict=True)])


def test_poses_shifted_by_one_image_are_recognised():
    cell = make_cell(5, views=8)
    views = observe(cell, 5)
    with pytest.raises(InconsistentPosesError, match="shifted by one image"):
        calibrate(cell, [with_pose(v, views[(i + 1) % 8].base_from_flange) for i, v in enumerate(views)])


def test_inverse_poses_are_recognised():
    cell = make_cell(5, views=8)
    views = [with_pose(v, transforms.inverse(v.base_from_flange)) for v in observe(cell, 5)]
    with pytest.raises(InconsistentPosesError, match="flange_from_base"):
        calibrate(cell, views)


def test_millimetres_in_some_or_all_poses_are_named():
    cell = make_cell(6, views=6)
    views = observe(cell, 6)

    def scaled(view):
        pose = view.base_from_flange.copy()
        pose[:3, 3] *= 1000
        return with_pose(view, pose)

    with pytest.raises(InvalidInputError, match=r"all views.*millimetres"):
        calibrate(cell, [scaled(v) for v in views])
    with pytest.raises(InvalidInputError, match=r"view02, view04.*millimetres"):
        calibrate(cell, [scaled(v) if i in (2, 4) else v for i, v in enumerate(views)])


def test_pose_that_is_not_rigid_is_named():
    cell = make_cell(6, views=6)
    views = observe(cell, 6)
    views[3].base_from_flange[0, 0] += 0.1
    with pytest.raises(InvalidInputError, match="view03: base_from_flange is not a rigid"):
        calibrate(cell, views)


@pytest.mark.parametrize("shift", [[0.0, 0.02, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.3, 0.0]])
def test_an_outlier_pose_is_left_out_and_named(shift):
    cell = make_cell(8, views=9)
    views = observe(cell, 8)
    views[4] = with_pose(views[4], transforms.perturb(views[4].base_from_flange, np.array(shift)))
    result = calibrate(cell, views)
    assert any("view04" in w and "does not fit" in w for w in result.warnings)
    assert "view04" not in result.names
    assert len(result.names) == 8
    delta = transforms.difference(result.flange_from_camera, cell.flange_from_camera)
    assert 1e3 * np.linalg.norm(delta[:3]) < 1.0


def test_two_swapped_images_are_named():
    cell = make_cell(9, views=10)
    views = observe(cell, 9)
    views[2], views[7] = (
        with_pose(views[2], views[7].base_from_flange),
        with_pose(views[7], views[2].base_from_flange),
    )
    result = calibrate(cell, views)
    assert any("view02 and view07 are swapped" in w for w in result.warnings)


def test_wrong_resolution_is_named():
    cell = make_cell(1, views=5)
    camera = CameraModel(320, 240, cell.camera.matrix)
    with pytest.raises(InvalidInputError, match=r"320x240.*another camera or resolution"):
        self_calibrate(observe(cell, 1), camera, cell.centers, SIZE, QUICK)


def test_dots_outside_the_pattern_are_named():
    cell = make_cell(1, views=5)
    with pytest.raises(InvalidInputError, match="outside the 10x10 pattern"):
        self_calibrate(observe(cell, 1), cell.camera, cell.centers[:10, :10], SIZE, QUICK)


def test_a_dot_claimed_twice_in_a_view_counts_not_at_all():
    cell = make_cell(1, views=3)
    views = observe(cell, 1)
    view = views[0]
    row, col = view.row.copy(), view.col.copy()
    row[5], col[5] = row[9], col[9]
    doubled = replace(view, row=row, col=col)
    assert (flatten([doubled], cell.centers).view == 0).sum() == len(view.row) - 2


# The pieces of the noise model


def test_correlated_errors_are_counted_as_fewer():
    rng = np.random.default_rng(0)
    grid = np.argwhere(np.ones((40, 50)))
    white = rng.normal(size=(3, 2000, 2))
    group = np.repeat(np.arange(3), 2000)
    assert correlation_inflation(np.tile(grid, (3, 1)), group, white.reshape(-1, 2)) < 1.3
    # Each value shared by blocks of 2 x 2 dots: four observations tell what one does.
    blocks = rng.normal(size=(3, 20, 25, 2)).repeat(2, axis=1).repeat(2, axis=2).reshape(-1, 2)
    assert 3.0 < correlation_inflation(np.tile(grid, (3, 1)), group, blocks) < 5.0


def test_centroid_displacement_is_that_of_a_drawn_disc():
    """Against the light-weighted centroid of a disc of the projector image on a sphere, summed point by point."""
    projector = CameraModel(*SIZE, np.array([[1900.0, 0, 512], [0, 1900, 700], [0, 0, 1]]))
    camera = CameraModel(640, 480, np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]]), "pers", (1.0,))
    centre, radius = np.array([0.0, -0.2, 1.5]), 0.25
    base_from_camera = transforms.look_at([0.5, 0.1, 0.7], centre - [0, 0, radius], [0.1, 1, 0])

    def hit(pixels):
        rays = projector.rays(pixels)
        b, a = rays @ centre, (rays**2).sum(-1)
        t = (b - np.sqrt(b**2 - a * (centre @ centre - radius**2))) / a
        return rays * t[..., None]

    row, col = np.meshgrid(np.arange(12), np.arange(12), indexing="ij")
    pixels = np.stack([430 + 14.0 * col, 370 + 14.0 * row], axis=-1).reshape(-1, 2)
    points = hit(pixels)
    dots = np.stack([row, col], axis=-1).reshape(-1, 2)
    cell_views = flatten(
        [View("a", dots[:, 0], dots[:, 1], np.zeros((144, 2)), np.eye(4))],
        pixels.reshape(12, 12, 2),
    )
    found, known = centroids.displacements(cell_views, points, base_from_camera[None], np.eye(4), camera, projector)
    assert known.sum() >= 60

    r, n = 4.0, 81
    offsets = np.stack(np.meshgrid(np.linspace(-r, r, n), np.linspace(-r, r, n)), axis=-1).reshape(-1, 2)
    offsets = offsets[np.linalg.norm(offsets, axis=-1) <= r]
    camera_from_base = transforms.inverse(base_from_camera)
    step = 1e-3
    for k in np.flatnonzero(known)[::7]:
        u = pixels[k] + offsets
        p = hit(u)
        normal = (p - centre) / radius
        light = -(normal * p).sum(-1) / np.linalg.norm(p, axis=-1) ** 3
        x = camera.project(transforms.apply(camera_from_base, p))
        x_u = camera.project(transforms.apply(camera_from_base, hit(u + [step, 0]))) - x
        x_v = camera.project(transforms.apply(camera_from_base, hit(u + [0, step]))) - x
        weight = light * np.abs(x_u[:, 0] * x_v[:, 1] - x_u[:, 1] * x_v[:, 0])
        centroid = (x * weight[:, None]).sum(0) / weight.sum()
        image = camera.project(transforms.apply(camera_from_base, points[k : k + 1]))[0]
        variance = (offsets[:, 0] ** 2).mean()
        np.testing.assert_allclose(variance * found[k], centroid - image, atol=2e-3)
        assert np.linalg.norm(centroid - image) > 5e-3


# The command


def write_input(folder, cell, views):
    pattern = default_pattern()
    pattern.save(folder / "pattern.yaml")
    k = cell.camera.matrix
    motion = {
        "camera": {
            "fx": k[0, 0],
            "fy": k[1, 1],
            "cx": k[0, 2],
            "cy": k[1, 2],
            "width": 640,
            "height": 480,
            "pers_f": cell.camera.coefficients[0] * k[0, 0] if cell.camera.coefficients else None,
        },
        "distortion_model": cell.camera.distortion_model,
        "robot_noise": {"mm": 0.1, "deg": 0.02},
        "views": [{"image": f"images/{v.name}.png", "base_from_flange": v.base_from_flange.tolist()} for v in views],
    }
    (folder / "motion.json").write_text(json.dumps(motion))
    (folder / "dots").mkdir(exist_ok=True)
    for v in views:
        lines = [f"{r},{c},{x:.4f},{y:.4f},0.99" for r, c, (x, y) in zip(v.row, v.col, v.pixels, strict=True)]
        (folder / "dots" / f"{v.name}.csv").write_text("row,col,x,y,confidence\n" + "\n".join(lines) + "\n")
    return [
        "--motion",
        str(folder / "motion.json"),
        "--correspondences",
        str(folder / "dots"),
        "--pattern",
        str(folder / "pattern.yaml"),
        "--output",
        str(folder / "calibration"),
        "--no-left-out",
    ]


@pytest.fixture
def pers_cell():
    cell = make_cell(7, views=7, lens="pers", step=1)
    cell.centers = default_pattern().centers
    return cell


def test_command_writes_the_calibration_folder(tmp_path, capsys, pers_cell):
    rows, cols = pers_cell.centers.shape[:2]
    assert (rows, cols) == (44, 58)
    arguments = write_input(tmp_path, pers_cell, observe(pers_cell, 7, wrong=0.01, missing=0.6))
    assert main([*arguments, "--no-projector-distortion", "--no-centroids"]) == 0
    printed = capsys.readouterr().out
    assert "training error" in printed
    assert str(tmp_path / "calibration" / "hand_eye.yaml") in printed
    found = calibration_files.load_calibration(tmp_path / "calibration")
    assert found.camera.distortion_model == "pers"
    assert found.flange_from_camera.extra["samples"] == 7
    delta = transforms.difference(found.flange_from_camera.transform, pers_cell.flange_from_camera)
    assert mahalanobis(delta, found.flange_from_camera.covariance) < 22.5
    assert (tmp_path / "calibration" / "points.csv").read_text().count("\n") > 500


def test_command_fails_with_one_line_and_writes_nothing(tmp_path, capsys, pers_cell):
    views = observe(pers_cell, 7, missing=0.6)
    arguments = write_input(tmp_path, pers_cell, views[:2])
    assert main(arguments) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: 2 usable views")
    assert error.count("\n") == 1
    assert not (tmp_path / "calibration").exists()


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda m: m.pop("views"), "entry 'views' is missing"),
        (lambda m: m["camera"].pop("fx"), "entry 'fx' is missing"),
        (lambda m: m["views"][1].update(base_from_flange=[[1, 2], [3, 4]]), "view01.*finite 4x4"),
        (lambda m: m.update(distortion_model="fisheye"), "'fisheye' is unknown"),
        (lambda m: m["views"][1].update(image=m["views"][0]["image"]), "more than once"),
    ],
)
def test_motion_files_that_cannot_be_used_are_named(tmp_path, pers_cell, edit, message):
    cell = pers_cell
    cell.camera = CameraModel(640, 480, cell.camera.matrix)
    write_input(tmp_path, cell, observe(cell, 7, missing=0.8)[:3])
    path = tmp_path / "motion.json"
    motion = json.loads(path.read_text())
    edit(motion)
    path.write_text(json.dumps(motion))
    with pytest.raises(InvalidInputError, match=message):
        load_views(load_motion(path), tmp_path / "dots")


def test_csv_with_a_broken_line_is_named_with_the_line(tmp_path, pers_cell):
    write_input(tmp_path, pers_cell, observe(pers_cell, 7, missing=0.8)[:3])
    path = tmp_path / "dots" / "view01.csv"
    path.write_text(path.read_text() + "3,x,1,2,1\n")
    with pytest.raises(InvalidInputError, match=r"view01.csv: data line \d+"):
        load_views(load_motion(tmp_path / "motion.json"), tmp_path / "dots")


# The rendered motion


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
