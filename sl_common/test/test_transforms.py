import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sl_common import transforms
from sl_common.errors import InvalidInputError

twists = arrays(np.float64, 6, elements=st.floats(-1.7, 1.7))
poses = twists.map(transforms.exp)


@given(twists)
def test_log_inverts_exp(twist):
    assert transforms.log(transforms.exp(twist)) == pytest.approx(twist, abs=1e-9)


@given(poses, poses)
def test_inverse_undoes_and_reverses_a_product(a, b):
    assert transforms.inverse(a) @ a == pytest.approx(np.eye(4), abs=1e-12)
    assert transforms.inverse(a @ b) == pytest.approx(transforms.inverse(b) @ transforms.inverse(a), abs=1e-12)


@given(poses, poses)
def test_difference_is_what_perturb_adds(a, b):
    assert transforms.perturb(a, transforms.difference(a, b)) == pytest.approx(b, abs=1e-9)


@given(poses)
def test_quaternion_round_trip(pose):
    translation, quaternion = transforms.to_quaternion(pose)
    assert np.linalg.norm(quaternion) == pytest.approx(1.0)
    assert transforms.from_quaternion(translation, 3.0 * quaternion) == pytest.approx(pose, abs=1e-12)


def test_exp_of_a_quarter_turn_about_z_moves_along_an_arc():
    moved = transforms.exp([np.pi / 2, 0, 0, 0, 0, np.pi / 2])
    assert moved[:3, 3] == pytest.approx([1, 1, 0])
    assert moved[:3, 0] == pytest.approx([0, 1, 0])


def test_functions_broadcast_over_leading_dimensions():
    rng = np.random.default_rng(1)
    poses = transforms.exp(rng.normal(size=(4, 3, 6)))
    points = rng.normal(size=(4, 3, 7, 3))
    mapped = transforms.apply(poses, points)
    single = (poses[2, 1] @ np.append(points[2, 1, 5], 1.0))[:3]
    assert mapped.shape == (4, 3, 7, 3)
    assert mapped[2, 1, 5] == pytest.approx(single)


def test_interpolation_reaches_both_ends_and_halves_the_angle():
    a, b = transforms.identity(), transforms.exp([1, 2, 3, 0, 0, 1.0])
    assert transforms.interpolate(a, b, 0.0) == pytest.approx(a)
    assert transforms.interpolate(a, b, 1.0) == pytest.approx(b)
    middle = transforms.interpolate(a, b, 0.5)
    assert transforms.rotation_angle(middle) == pytest.approx(0.5)
    assert middle[:3, 3] == pytest.approx(b[:3, 3] / 2)


def test_look_at_puts_the_target_on_the_optical_axis_with_up_upwards():
    base_from_camera = transforms.look_at([1.0, 0.0, 0.5], [2.0, 1.0, 0.2])
    target = transforms.inverse(base_from_camera) @ [2.0, 1.0, 0.2, 1.0]
    assert target[:2] == pytest.approx([0, 0])
    assert target[2] > 0
    assert base_from_camera[2, 1] < 0, "image y points down"
    assert transforms.is_rigid(base_from_camera)


def test_bad_input_is_refused_with_the_number():
    with pytest.raises(InvalidInputError, match="norm 0"):
        transforms.from_quaternion([0, 0, 0], [0, 0, 0, 0])
    with pytest.raises(InvalidInputError, match="look_at"):
        transforms.look_at([0, 0, 0], [0, 0, 1])
    assert not transforms.is_rigid(np.diag([1.0, 1.0, -1.0, 1.0]))
    assert not transforms.is_rigid(np.full((4, 4), np.nan))
