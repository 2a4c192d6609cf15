"""Camera-projector calibration: known truth from any start, stated uncertainty, refusals, real captures."""

import os
import shutil
from itertools import combinations
from pathlib import Path

import board_scenes
import cv2
import numpy as np
import pytest
import yaml

from sl_calibration.board_bundle import OddViewError
from sl_calibration.camera_calibration import rms
from sl_calibration.commands.calibrate_procam import main
from sl_calibration.projector_calibration import ProcamOptions, calibrate_procam
from sl_calibration.virtual_screen import growth, starting_centers, virtual_screen
from sl_common import transforms
from sl_common.calibration_files import load_camera, load_pose
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError

SIZES = ((board_scenes.CAMERA.width, board_scenes.CAMERA.height), (640, 480))


def calibrate(scene, **options):
    return calibrate_procam(
        scene.camera_corners, scene.projector_corners, board_scenes.BOARD, *SIZES, ProcamOptions(**options)
    )


def assert_close(result, factor=3.0):
    for parameters, model in (
        (result.camera_parameters, board_scenes.CAMERA),
        (result.projector_parameters, board_scenes.PROJECTOR),
    ):
        m = model.matrix
        for name, value in {"fx": m[0, 0], "fy": m[1, 1], "cx": m[0, 2], "cy": m[1, 2]}.items():
            assert abs(parameters[name]["value"] - value) < factor * parameters[name]["sigma"], name
    delta = transforms.difference(result.camera_from_projector, transforms.inverse(board_scenes.PROJECTOR_FROM_CAMERA))
    assert (np.abs(delta) < factor * np.sqrt(np.diag(result.pose_covariance))).all()


def test_recovers_a_shifted_lens_without_being_told():
    result = calibrate(board_scenes.pair_scene(6))
    assert_close(result)
    assert result.projector.matrix[1, 2] == pytest.approx(540, abs=8)
    assert result.projector.matrix[0, 0] == pytest.approx(800, abs=8)
    assert rms(result.projector_residuals) == pytest.approx(0.1 * np.sqrt(2), rel=0.15)
    assert result.left_out_projector.mean() < 0.5
    assert result.rigid_fit.mean() < 0.4


@pytest.mark.parametrize("start", [(300.0, 100.0, 100.0), (5000.0, 320.0, 240.0), (800.0, 330.0, 540.0)])
def test_the_start_does_not_matter(start):
    f, cx, cy = start
    guess = CameraModel(640, 480, np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]]))
    scene = board_scenes.pair_scene(4)
    result = calibrate(scene, start=guess)
    reference = calibrate(scene)
    assert np.allclose(result.projector.matrix, reference.projector.matrix, atol=0.05)


@pytest.mark.parametrize("views", list(combinations(range(4), 2)))
def test_two_views_give_a_result_within_its_uncertainty(views):
    scene = board_scenes.pair_scene(4, seed=20)
    chosen = list(views)
    result = calibrate_procam(scene.camera_corners[chosen], scene.projector_corners[chosen], board_scenes.BOARD, *SIZES)
    assert_close(result)


def test_a_corner_of_the_board_that_lifts_is_left_out():
    scene = board_scenes.pair_scene(6)
    bent = board_scenes.BOARD.points.copy()
    bent[0, 2] -= 0.004
    camera = np.stack([board_scenes.CAMERA.project(transforms.apply(p, bent)) for p in scene.camera_from_board])
    seen = np.stack(
        [
            board_scenes.PROJECTOR.project(transforms.apply(board_scenes.PROJECTOR_FROM_CAMERA @ p, bent))
            for p in scene.camera_from_board
        ]
    )
    scene.camera_corners[:, 0], scene.projector_corners[:, 0] = camera[:, 0], seen[:, 0]
    result = calibrate(scene)
    assert np.isnan(result.camera_residuals[:, 0]).all()
    assert result.rejected <= 8
    assert_close(result)


def test_one_view_is_refused():
    with pytest.raises(InvalidInputError, match="too few views: 1"):
        calibrate(board_scenes.pair_scene(1))


def test_a_view_with_the_projector_moved_is_named():
    scene = board_scenes.pair_scene(5)
    moved = transforms.perturb(board_scenes.PROJECTOR_FROM_CAMERA, np.array([0.05, 0.03, 0, 0.02, 0.05, 0.0]))
    scene.projector_corners[2] = board_scenes.corners_of(
        board_scenes.PROJECTOR, (moved @ scene.camera_from_board[2])[None], noise=0.1
    )[0]
    with pytest.raises(OddViewError, match="view 3 does not fit the others"):
        calibrate(scene)


def test_virtual_screen():
    assert growth(856.5, 768 - 856.5) == pytest.approx(2.2305, abs=1e-4)
    screen = virtual_screen(1024, 768, np.array([511.5, 855.5]))
    assert (screen.width, screen.height) == (1024, 1712)
    assert (screen.left, screen.top, screen.growth_x) == (0, 0, 1)
    assert screen.growth_y == pytest.approx(1712 / 768)
    up = virtual_screen(1024, 768, np.array([511.5, -88.5]))
    assert up.height == 1712
    assert up.top == 1712 - 768
    assert starting_centers(1024, 768)[0] == (511.5, 383.5)


def write_captures(folder: Path, number: int) -> list[str]:
    paths = []
    for k, pose in enumerate(board_scenes.poses(number, tilt=0.45, seed=31)):
        own = folder / f"capture_{k}"
        own.mkdir()
        for m, image in enumerate(board_scenes.gray_capture(pose, seed=k)):
            cv2.imwrite(str(own / f"image_{m}.png"), image)
        paths.append(str(own))
    return paths


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    return write_captures(tmp_path_factory.mktemp("captures"), 3)


def arguments(output, paths, **changes):
    options = {"--board": "9x7", "--square": "0.04", "--projector": "640x480", "--output": str(output)} | changes
    return [*(part for pair in options.items() for part in pair), *paths]


def test_command_from_photographs_to_files(tmp_path, captures, capsys):
    assert main(arguments(tmp_path / "calibration", captures)) == 0
    text = capsys.readouterr().out
    for words in ("training: camera", "left out: camera", "rigid fit", "worst view: capture_", "virtual screen"):
        assert words in text
    projector = load_camera(tmp_path / "calibration" / "projector.yaml")
    camera = load_camera(tmp_path / "calibration" / "camera.yaml")
    data = yaml.safe_load((tmp_path / "calibration" / "projector.yaml").read_text())
    for value, truth, name in (
        (projector.matrix[0, 0], 800, "fx"),
        (projector.matrix[1, 2], 540, "cy"),
        (projector.matrix[0, 2], 330, "cx"),
    ):
        assert abs(value - truth) < 3 * data["uncertainty_one_sigma"][name]
    assert camera.matrix[0, 0] == pytest.approx(900, rel=0.02)
    assert data["samples"] == 3
    assert data["residuals"]["training_rms_px"] < 0.2
    pose = load_pose(tmp_path / "calibration" / "camera_from_projector.yaml", "camera_from_projector")
    truth = transforms.inverse(board_scenes.PROJECTOR_FROM_CAMERA)
    assert np.linalg.norm(pose.transform[:3, 3] - truth[:3, 3]) < 0.02


@pytest.mark.parametrize(
    ("changes", "number", "message"),
    [
        ({"--board": "8x6"}, 2, "wrong board size? Give --board 9x7"),
        ({"--square": "40"}, 2, "mixed units"),
        ({"--projector": "1024x768"}, 2, "is 1024x768 the projector's size"),
        ({"--projector": "640x1080"}, 2, "40 images for a 640x1080 projector, expected 44"),
        ({}, 1, "too few views: 1"),
        ({"--board": "nine"}, 2, "expected two whole numbers"),
    ],
)
def test_command_refuses_and_writes_nothing(tmp_path, captures, capsys, changes, number, message):
    output = tmp_path / "out"
    assert main(arguments(output, captures[:number], **changes)) == 1
    error = capsys.readouterr().err.strip().splitlines()[-1]
    assert error.startswith("error: ")
    assert message in error
    assert not output.exists()


def test_command_names_swapped_images(tmp_path, captures, capsys):
    damaged = tmp_path / "damaged"
    shutil.copytree(captures[0], damaged)
    (damaged / "image_8.png").rename(damaged / "other.tmp")
    (damaged / "image_9.png").rename(damaged / "image_8.png")
    (damaged / "other.tmp").rename(damaged / "image_9.png")
    output = tmp_path / "out"
    assert main(arguments(output, [captures[1], str(damaged)])) == 1
    error = capsys.readouterr().err
    assert "damaged: image_8.png and image_9.png are swapped" in error
    assert not output.exists()


@pytest.mark.skipif("SL_TEST_DATA" not in os.environ, reason="SL_TEST_DATA is not set")
def test_real_captures_of_a_shifted_projector(tmp_path):
    from pattern_gen.gray_code import Arrangement
    from sl_calibration.chessboard import Board
    from sl_calibration.commands.calibrate_procam import correspond, load_capture

    board = Board(9, 7, 0.075)
    folders = sorted((Path(os.environ["SL_TEST_DATA"]) / "kamino_procam").glob("capture_*"))[:4]
    pairs = [correspond(load_capture(f, (1024, 768), Arrangement.REFLECTED), f, board) for f in folders]
    camera, projector = (np.array(part) for part in zip(*pairs, strict=True))
    result = calibrate_procam(camera, projector, board, (1280, 1024), (1024, 768))
    assert rms(result.camera_residuals) <= 0.307
    assert rms(result.projector_residuals) <= 0.187
    assert result.left_out_projector.mean() <= 0.318
    assert result.rigid_fit.mean() <= 0.47
    matrix = result.projector.matrix
    assert np.abs(matrix[[0, 1], [0, 1]] - 1892).max() <= 10
    assert np.abs(matrix[:2, 2] - (504, 856)).max() <= 20
    for chosen in ((0, 2), (1, 3)):
        pair = calibrate_procam(camera[list(chosen)], projector[list(chosen)], board, (1280, 1024), (1024, 768))
        for name, value in {"fx": 1892, "fy": 1892, "cx": 504, "cy": 856}.items():
            entry = pair.projector_parameters[name]
            assert abs(entry["value"] - value) < 2.5 * entry["sigma"], (chosen, name)
