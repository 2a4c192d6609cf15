"""Hand-eye calibration: exact on exact data, inside its uncertainty on noise, streams out of step, refusals, a real
arm."""

import os
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation, Slerp

from sl_calibration.commands.hand_eye import main
from sl_calibration.hand_eye import HandEyeOptions, calibrate_hand_eye
from sl_calibration.hand_eye_closed_forms import motion_pairs, solve_daniilidis, solve_park, solve_tsai
from sl_calibration.pose_stream import PoseStream, load_poses, make_stream
from sl_calibration.time_offset import estimate_offset
from sl_common import transforms
from sl_common.calibration_files import load_pose
from sl_common.errors import InvalidInputError

HAND_EYE = transforms.make(transforms.rotation_exp([0.3, -0.2, 1.4]), [0.04, -0.02, 0.11])
TARGET = transforms.make(transforms.rotation_exp([2.9, 0.2, 0.1]), [0.6, 0.1, 0.05])


def noisy(poses, position, rotation, seed):
    rng = np.random.default_rng(seed)
    delta = np.concatenate(
        [rng.normal(0, position, (len(poses), 3)), rng.normal(0, rotation, (len(poses), 3))], axis=-1
    )
    return transforms.perturb(poses, delta)


def single_poses(number=15, *, noise=0.0, turn=0.6, seed=0):
    """base_from_hand and camera_from_target of poses that look at the target; noise [m], a degree per centimetre."""
    rng = np.random.default_rng(seed)
    looking = transforms.make(transforms.rotation_exp([np.pi, 0, 0]), [0.55, 0.1, 0.6])
    delta = np.concatenate([rng.uniform(-0.15, 0.15, (number, 3)), rng.uniform(-turn, turn, (number, 3))], axis=-1)
    hand = transforms.perturb(looking, delta)
    eye = transforms.inverse(hand @ HAND_EYE) @ TARGET
    return noisy(hand, noise / 5, noise / 5, seed + 1), noisy(eye, noise, noise * 1.7, seed + 2)


def stream(poses, times=None):
    times = np.arange(float(len(poses))) if times is None else times
    return PoseStream(np.asarray(times, dtype=float), poses, np.arange(1, len(poses) + 1))


def moving(offset=0.06, *, noise=0.001, seed=0, seconds=20.0):
    """Streams of a moving arm: the hand at 100 Hz, the eye at 30 Hz with its stamps ``offset`` late."""
    rng = np.random.default_rng(seed)
    knots = np.arange(0, seconds + 4, 1.5)
    position = np.array([0.55, 0.1, 0.6]) + rng.uniform(-0.15, 0.15, (len(knots), 3))
    rotation = Slerp(
        knots, Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (len(knots), 3))) * Rotation.from_rotvec([np.pi, 0, 0])
    )

    def hand_at(times):
        return transforms.make(
            rotation(times).as_matrix(), np.stack([np.interp(times, knots, position[:, k]) for k in range(3)], axis=-1)
        )

    hand_times = np.arange(0, seconds, 0.01)
    true_times = np.arange(0.5, seconds - 0.5, 1 / 30) + rng.uniform(-0.003, 0.003, int(np.ceil((seconds - 1) * 30)))
    eye = transforms.inverse(hand_at(true_times) @ HAND_EYE) @ TARGET
    return stream(hand_at(hand_times), hand_times), stream(noisy(eye, noise, 2 * noise, seed + 3), true_times + offset)


def error(estimate):
    delta = transforms.difference(HAND_EYE, estimate)
    return np.linalg.norm(delta[:3]), np.linalg.norm(delta[3:])


@pytest.mark.parametrize(("every", "offset"), [(8, 0.06), (15, -0.04), (60, 0.0)])
def test_an_eye_at_any_rate_is_paired_with_a_dense_hand(every, offset):
    """30 Hz thinned to 4 and 2 Hz, whose offset is found, and to one look every two seconds, which tells none."""
    hand, eye = moving(offset, seconds=60.0 if every > 15 else 30.0)
    slow = PoseStream(eye.times[::every], eye.poses[::every], eye.rows[::every])
    result = calibrate_hand_eye(hand, slow)
    assert len(result.rows) >= 0.9 * len(slow)
    assert result.offset_estimated == (every < 60)
    if result.offset_estimated:
        assert result.time_offset == pytest.approx(-offset, abs=3e-3)
    assert error(result.flange_from_camera)[0] < 4 * np.sqrt(np.trace(result.covariance[:3, :3]))
    assert error(result.flange_from_camera)[0] < 0.006


@pytest.mark.parametrize("solver", [solve_tsai, solve_park, solve_daniilidis])
def test_closed_forms_are_exact_on_exact_data(solver):
    hand, eye = single_poses(8)
    pairs = motion_pairs(hand, eye, least_angle=0.1, angle_tolerance=0.05)
    assert pairs.agreement == 1.0
    assert error(solver(pairs)) == pytest.approx((0, 0), abs=1e-7)


def test_pairs_of_small_rotation_are_left_out():
    hand, eye = single_poses(10)
    few = motion_pairs(hand, eye, least_angle=0.5, angle_tolerance=0.05)
    assert (transforms.rotation_angle(few.hand) > 0.5).all()
    assert len(few.hand) < 45


@pytest.mark.parametrize("inverted", [False, True])
def test_exact_poses_in_either_direction(inverted):
    hand, eye = single_poses(8)
    result = calibrate_hand_eye(stream(hand), stream(transforms.inverse(eye) if inverted else eye))
    assert result.eye_inverted is inverted
    assert error(result.flange_from_camera) == pytest.approx((0, 0), abs=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_truth_lies_inside_the_stated_region(seed):
    hand, eye = single_poses(20, noise=0.001, seed=10 * seed)
    result = calibrate_hand_eye(stream(hand), stream(eye))
    delta = transforms.difference(result.flange_from_camera, HAND_EYE)
    assert delta @ np.linalg.solve(result.covariance, delta) < 25  # 6 degrees of freedom: 99.97 %
    assert np.sqrt(np.trace(result.covariance[:3, :3])) < 0.004
    assert error(result.flange_from_camera)[0] < 0.003
    assert not result.offset_estimated


def test_refinement_beats_the_closed_forms():
    refined, closed = [], []
    for seed in range(4):
        hand, eye = single_poses(12, noise=0.002, seed=7 * seed)
        refined.append(error(calibrate_hand_eye(stream(hand), stream(eye)).flange_from_camera)[0])
        pairs = motion_pairs(hand, eye, least_angle=0.1, angle_tolerance=0.1)
        closed.append(error(solve_park(pairs))[0])
    assert np.mean(refined) < np.mean(closed)


@pytest.mark.parametrize("offset", [-0.12, 0.0, 0.06])
def test_streams_out_of_step(offset):
    hand, eye = moving(offset, seconds=12)
    assert estimate_offset(hand, eye, 0.5) == pytest.approx(-offset, abs=0.02)
    result = calibrate_hand_eye(hand, eye)
    assert result.time_offset == pytest.approx(-offset, abs=0.002)
    assert error(result.flange_from_camera)[0] < 0.002
    assert np.degrees(error(result.flange_from_camera)[1]) < 0.1
    delta = transforms.difference(result.flange_from_camera, HAND_EYE)
    assert (np.abs(delta) < 4 * np.sqrt(np.diag(result.covariance))).all()


def test_epoch_stamps_lose_no_digits():
    hand, eye = moving(0.06, seconds=8)
    late = [PoseStream(s.times + 1.7e9, s.poses, s.rows) for s in (hand, eye)]
    assert calibrate_hand_eye(*late).time_offset == pytest.approx(-0.06, abs=0.002)


def shuffled(hand, eye):
    return hand, eye[np.random.default_rng(5).permutation(len(eye))]


def centimetres(hand, eye):
    scaled = eye.copy()
    scaled[:, :3, 3] *= 10
    return hand, scaled


def outlier(hand, eye):
    moved = eye.copy()
    moved[6] = transforms.perturb(moved[6], np.array([0.08, 0, 0.05, 0.0, 0.1, 0]))
    return hand, moved


def translation_only(hand, eye):
    hand = hand.copy()
    hand[:, :3, :3] = hand[0, :3, :3]
    return hand, transforms.inverse(hand @ HAND_EYE) @ TARGET


def one_axis(hand, eye):
    hand = transforms.perturb(hand[0], np.linspace(0, 1, len(hand))[:, None] * np.array([0.1, 0, 0, 0, 0, 1.5]))
    return hand, transforms.inverse(hand @ HAND_EYE) @ TARGET


REFUSED = [
    (shuffled, "shuffled poses"),
    (centimetres, "mixed units: lengths of the eye must be multiplied by 0.1"),
    (outlier, "outlier pose: line 7"),
    (translation_only, "degenerate motion: the hand turns by 0.0 deg"),
    (one_axis, "degenerate motion: all rotations are about one axis"),
    (lambda h, e: (h[:4], e[:4]), "too few poses: 4"),
]


@pytest.mark.parametrize(("damage", "message"), REFUSED)
def test_bad_data_is_refused_by_name(damage, message):
    hand, eye = damage(*single_poses(15, noise=0.0005))
    with pytest.raises(InvalidInputError, match=message):
        calibrate_hand_eye(stream(hand), stream(eye))


def test_outliers_can_be_left_out_on_request():
    hand, eye = outlier(*single_poses(15, noise=0.0005))
    result = calibrate_hand_eye(stream(hand), stream(eye), HandEyeOptions(reject_outliers=True))
    assert result.rejected_rows.tolist() == [7]
    assert error(result.flange_from_camera)[0] < 0.002


def rows_of(poses, times):
    translation, quaternion = transforms.to_quaternion(poses)
    return np.concatenate([np.asarray(times)[:, None], translation, quaternion], axis=-1)


def write_csv(path: Path, poses, times, *, header=True, scale=1.0):
    rows = rows_of(poses, times)
    rows[:, 1:4] *= scale
    lines = ["t,x,y,z,qx,qy,qz,qw"] if header else []
    path.write_text("\n".join([*lines, *(",".join(f"{value:.9f}" for value in row) for row in rows)]) + "\n")


@pytest.mark.parametrize("header", [True, False])
def test_command_writes_the_file(tmp_path, capsys, header):
    hand, eye = single_poses(15, noise=0.0005)
    write_csv(tmp_path / "hand.csv", hand, range(15), header=header)
    write_csv(tmp_path / "eye.csv", eye, range(15), header=header)
    output = tmp_path / "hand_eye.yaml"
    arguments = ["--hand", str(tmp_path / "hand.csv"), "--eye", str(tmp_path / "eye.csv"), "--output", str(output)]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    for words in ("training:", "left out:", "worst sample left out: line", "Daniilidis"):
        assert words in text
    saved = load_pose(output, "flange_from_camera")
    assert error(saved.transform)[0] < 0.002
    assert np.linalg.eigvalsh(saved.covariance).min() > 0
    data = yaml.safe_load(output.read_text())
    assert data["samples"] == 15
    assert {"date", "units", "residuals", "covariance"} <= set(data)


def test_command_refuses_and_writes_nothing(tmp_path, capsys):
    hand, eye = single_poses(15, noise=0.0005)
    times = range(15)
    output = tmp_path / "hand_eye.yaml"
    hand_file, eye_file = tmp_path / "hand.csv", tmp_path / "eye.csv"

    def attempt(message):
        assert main(["--hand", str(hand_file), "--eye", str(eye_file), "--output", str(output)]) == 1
        text = capsys.readouterr().err.strip()
        assert text.startswith("error: ")
        assert message in text
        assert "\n" not in text
        assert not output.exists()

    write_csv(eye_file, eye, times)
    attempt("hand.csv: no such file")
    write_csv(hand_file, hand, times, scale=1000)
    attempt("mixed units")
    for damage, message in REFUSED:
        bad_hand, bad_eye = damage(hand, eye)
        write_csv(hand_file, bad_hand, times[: len(bad_hand)])
        write_csv(eye_file, bad_eye, times[: len(bad_eye)], header=False)
        attempt(message)
    write_csv(hand_file, hand, np.arange(15) + 1000.0)
    write_csv(eye_file, eye, times)
    attempt("do not overlap in time")
    hand_file.write_text("t,x,y,z\n1,2,3,4\n2,3,4,5\n")
    attempt("line 2 is not eight")


def test_streams_are_read_in_any_order_and_once_per_stamp(tmp_path):
    hand, _ = single_poses(5)
    rows = rows_of(hand, [3.0, 1.0, 2.0, 2.0, 5.0])
    read = make_stream(rows)
    assert read.times.tolist() == [1, 2, 3, 5]
    assert np.allclose(read.poses[1], hand[2])
    assert np.allclose(read.at(np.array([1.0, 9.0])), [hand[1], hand[4]])
    assert read.gap(np.array([2.0, 4.0, 6.0])).tolist() == [0, 2, np.inf]
    (tmp_path / "zero.csv").write_text("1,0,0,0,0,0,0,0\n2,0,0,0,0,0,0,1\n")
    with pytest.raises(InvalidInputError, match="quaternion of norm 0"):
        load_poses(tmp_path / "zero.csv")


@pytest.mark.skipif("SL_TEST_DATA" not in os.environ, reason="SL_TEST_DATA is not set")
def test_real_arm_left_out_consistency():
    folder = Path(os.environ["SL_TEST_DATA"]) / "ethz_hand_eye" / "robot_arm_w_color_camera_real" / "robot_arm"
    hand = load_poses(next(folder.glob("*hinge.csv")))
    eye = load_poses(next(folder.glob("*target_ir.csv")))
    result = calibrate_hand_eye(hand, eye)
    assert 1e3 * result.left_out_position.mean() < 4.0
    assert np.degrees(result.left_out_rotation.mean()) < 0.63
    park = result.closed_forms["Park"]
    assert result.position_error.mean() < park[0]
