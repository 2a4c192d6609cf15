"""The calibration procedures behind the calibrator: samples in, coverage and results out, files written."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

import board_scenes

from pattern_gen.gray_code import bit_count
from pattern_gen.projection import Mode
from sl_calibration.camera_calibration import CameraOptions
from sl_calibration.motion_plan import next_pose
from sl_calibration.procedures.camera import CameraProcedure
from sl_calibration.procedures.colours import ColoursProcedure
from sl_calibration.procedures.hand_eye import HandEyeProcedure
from sl_calibration.procedures.procam import ProcamProcedure
from sl_calibration.procedures.procedure import Setup, Shot, flange_poses
from sl_calibration.sessions import Sample, Session, SessionPattern
from sl_common import transforms
from sl_common.calibration_files import (
    HAND_EYE_FILE,
    HAND_EYE_KEY,
    PROJECTOR_POSE_FILE,
    PoseCalibration,
    load_camera,
    load_hand_eye,
    load_projector_pose,
    save_pose,
)
from sl_common.errors import CalibrationFileError, InvalidInputError

BOARD, CAMERA = board_scenes.BOARD, board_scenes.CAMERA
SIZE = np.array([CAMERA.width, CAMERA.height])
HAND_EYE = transforms.make(transforms.rotation_exp([0.1, -0.2, 0.9]), [0.03, -0.05, 0.1])
PATTERN = SessionPattern("p", np.zeros((3, 3, 2)), (640, 480), 8.0)


def setup_in(folder, camera=CAMERA, pattern=PATTERN):
    return Setup(camera, pattern, folder)


def image_of(camera_from_board):
    grey = np.clip(250 * board_scenes.board_albedo(CAMERA, camera_from_board, BOARD), 0, 255).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=-1)


def camera_samples(number, **options):
    poses = board_scenes.poses(number, **options)
    corners = board_scenes.corners_of(CAMERA, poses, noise=0.1)
    return [Sample(f"image_{k}", k, {"corners": c, "size": SIZE}) for k, c in enumerate(corners)]


def test_camera_from_images_to_a_file(tmp_path):
    procedure = CameraProcedure(board=BOARD, options=CameraOptions("plumb_bob"))
    pose = board_scenes.poses(1, seed=3)[0]
    measured = procedure.measure(Shot(7, images=(image_of(pose),)), setup_in(tmp_path))
    truth = CAMERA.project(transforms.apply(pose, BOARD.points))
    assert np.abs(measured.arrays["corners"] - truth).max() < 0.3
    assert procedure.points(measured) == len(BOARD.points)

    samples = camera_samples(7)
    outcome = procedure.compute(samples, setup_in(tmp_path))
    assert outcome.rms == pytest.approx(0.1 * np.sqrt(2), rel=0.2)
    assert set(outcome.residuals) == {s.name for s in samples}
    (path,) = procedure.save(outcome, tmp_path / "calibration", setup_in(tmp_path))
    assert path == (tmp_path / "calibration" / "camera.yaml").resolve()
    assert load_camera(path).matrix[0, 0] == pytest.approx(900, abs=10)


def test_camera_says_what_is_missing(tmp_path):
    procedure, setup = CameraProcedure(board=BOARD), setup_in(tmp_path)
    assert "no samples yet" in procedure.coverage([], setup, None).message
    with pytest.raises(InvalidInputError, match="too few views: 0"):
        procedure.compute([], setup)
    alike = camera_samples(4, tilt=0.02)
    said = procedure.coverage(alike, setup, None)
    assert "tilt it by 30 deg and more" in said.message
    assert said.rotation < 0.3
    tilted = procedure.coverage(camera_samples(4), setup, None)
    assert tilted.rotation > said.rotation
    assert "hold the board" in tilted.message
    other = replace(alike[0], arrays=alike[0].arrays | {"size": np.array([640, 480])})
    with pytest.raises(InvalidInputError, match="640x480 and 800x600"):
        procedure.compute([*alike, other], setup)


def hand_eye_samples(number, *, turn=0.5, seed=0):
    """Views of a board that stands still, corners with 0.1 px and flange poses with 0.1 mm and 0.02 deg of noise."""
    rng = np.random.default_rng(seed)
    camera_from_board = board_scenes.poses(number, tilt=turn, seed=seed)
    base_from_board = transforms.make(transforms.rotation_exp([2.9, 0.2, 0.1]), [0.6, 0.1, 0.05])
    hand = base_from_board @ transforms.inverse(camera_from_board) @ transforms.inverse(HAND_EYE)
    noise = np.hstack([rng.normal(0, 1e-4, (number, 3)), rng.normal(0, np.radians(0.02), (number, 3))])
    reported = transforms.perturb(hand, noise)
    corners = board_scenes.corners_of(CAMERA, camera_from_board, noise=0.1, seed=seed + 1)
    return [
        Sample(f"image_{k}", k, {"corners": c, "size": SIZE, "base_from_flange": p, "joints": np.zeros(6)})
        for k, (c, p) in enumerate(zip(corners, reported, strict=True))
    ]


def test_hand_eye_from_views_of_a_board_to_a_file(tmp_path):
    procedure, setup = HandEyeProcedure(board=BOARD), setup_in(tmp_path)
    samples = hand_eye_samples(16)
    outcome = procedure.compute(samples, setup)
    (path,) = procedure.save(outcome, tmp_path, setup)
    found = load_hand_eye(path.parent)
    delta = transforms.difference(HAND_EYE, found.transform)
    assert np.linalg.norm(delta[:3]) < 2e-3
    assert (np.abs(delta) < 4 * np.sqrt(np.diag(found.covariance))).all()
    assert outcome.rms < 1.0
    assert np.isfinite(outcome.hand_eye_sigma).all()
    assert np.isnan(outcome.projector_sigma).all()
    estimate = procedure.estimate(samples, setup)
    assert np.linalg.norm(transforms.difference(HAND_EYE, estimate.flange_from_camera)[:3]) < 5e-3
    assert next_pose(flange_poses(samples), estimate) is not None
    assert "enough" in procedure.coverage(samples, setup, estimate).message


def test_hand_eye_leaves_an_outlier_out_and_names_it(tmp_path):
    procedure, setup = HandEyeProcedure(board=BOARD), setup_in(tmp_path)
    samples = hand_eye_samples(16)
    wrong = transforms.perturb(samples[5].arrays["base_from_flange"], np.array([0.03, 0, 0, 0, 0.1, 0]))
    samples[5] = replace(samples[5], arrays=samples[5].arrays | {"base_from_flange": wrong})
    outcome = procedure.compute(samples, setup)
    assert "image_5" in outcome.message
    assert "image_5" not in outcome.residuals


def test_hand_eye_says_what_is_missing(tmp_path):
    procedure = HandEyeProcedure(board=BOARD)
    with pytest.raises(InvalidInputError, match="too few poses: 3"):
        procedure.compute(hand_eye_samples(3), setup_in(tmp_path))
    with pytest.raises(InvalidInputError, match="no camera model"):
        procedure.compute(hand_eye_samples(6), setup_in(tmp_path, camera=None))
    shot = Shot(1, images=(image_of(board_scenes.poses(1, seed=3)[0]),))
    with pytest.raises(InvalidInputError, match="no flange pose"):
        procedure.measure(shot, setup_in(tmp_path))
    few = hand_eye_samples(4, turn=0.02)
    assert "turn about other axes too" in procedure.coverage(few, setup_in(tmp_path), None).message


def test_procam_projects_the_sequence_that_it_reads(tmp_path):
    procedure, setup = ProcamProcedure(board=BOARD), setup_in(tmp_path)
    frames = procedure.frames(setup)
    assert len(frames) == 2 * (bit_count(640) + bit_count(480)) + 2
    assert [f.mode for f in frames[-2:]] == [Mode.WHITE, Mode.BLACK]
    pose = board_scenes.poses(1, tilt=0.45, seed=31)[0]
    sample = procedure.measure(Shot(5, images=tuple(board_scenes.gray_capture(pose))), setup)
    points = transforms.apply(board_scenes.PROJECTOR_FROM_CAMERA @ pose, BOARD.points)
    error = sample.arrays["projector_corners"] - board_scenes.PROJECTOR.project(points)
    assert np.nanmax(np.abs(error)) < 0.6
    assert procedure.points(sample) > 50
    with pytest.raises(InvalidInputError, match="too few views: 1"):
        procedure.compute([sample], setup)
    with pytest.raises(InvalidInputError, match="no pattern received"):
        procedure.frames(setup_in(tmp_path, pattern=None))


def test_procam_places_the_projector_where_flange_and_hand_eye_are_known(tmp_path):
    scene = board_scenes.pair_scene(3)
    samples = [
        Sample(f"capture_{k}", k, {"corners": seen, "projector_corners": lit, "size": SIZE})
        for k, (seen, lit) in enumerate(zip(scene.camera_corners, scene.projector_corners, strict=True))
    ]
    flange = transforms.make(transforms.rotation_exp([0.5, 0.1, -0.3]), [0.4, 0.1, 0.6])
    setup = setup_in(tmp_path)
    procedure = ProcamProcedure(board=BOARD, base_from_flange=flange)
    outcome = procedure.compute(samples, setup)
    with pytest.raises(CalibrationFileError, match=HAND_EYE_FILE):
        procedure.save(outcome, tmp_path / "out", setup)
    assert not (tmp_path / "out").exists()
    save_pose(tmp_path / HAND_EYE_FILE, HAND_EYE_KEY, PoseCalibration(HAND_EYE))
    files = procedure.save(outcome, tmp_path / "out", setup)
    assert tuple(path.name for path in files) == procedure.writes
    assert files[-1].name == PROJECTOR_POSE_FILE
    placed = load_projector_pose(tmp_path / "out")
    truth = flange @ HAND_EYE @ transforms.inverse(board_scenes.PROJECTOR_FROM_CAMERA)
    assert (np.abs(transforms.difference(placed.transform, truth)) < 4 * np.sqrt(np.diag(placed.covariance))).all()
    assert PROJECTOR_POSE_FILE not in ProcamProcedure(board=BOARD).writes


def test_colours_wants_a_sample_and_letters(tmp_path):
    procedure, setup = ColoursProcedure(intensity_chart=True), setup_in(tmp_path)
    assert len(procedure.frames(setup)) == 28 + 54
    with pytest.raises(InvalidInputError, match="no samples"):
        procedure.compute([], setup)


def test_a_session_keeps_any_procedure_s_samples(tmp_path):
    session = Session(tmp_path / "s", "hand_eye")
    sample = hand_eye_samples(3)[0]
    session.add(sample)
    session.set_camera(CAMERA)
    again = Session(tmp_path / "s", "hand_eye")
    assert again.samples[0].name == sample.name
    for key, value in sample.arrays.items():
        np.testing.assert_array_equal(again.samples[0].arrays[key], value)
    with pytest.raises(InvalidInputError, match="a session of procedure 'hand_eye', not 'camera'"):
        Session(tmp_path / "s", "camera")
