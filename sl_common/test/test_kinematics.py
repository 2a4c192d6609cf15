import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sl_common import transforms
from sl_common.errors import InvalidInputError, ModelError
from sl_common.kinematics import Kinematics


def joint(name, kind, parent, child, xyz, axis, limit='<limit lower="-2" upper="2.5" velocity="3" effort="1"/>'):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="0.1 -0.2 0.3"/><axis xyz="{axis}"/>{limit}</joint>'
    )


# A turntable, a base on it that is not the world, a continuous joint, a slide, and a gripper joint off the chain.
URDF = (
    '<robot name="arm">'
    + "".join(f'<link name="{n}"/>' for n in ("world", "base", "a", "b", "c", "tool0", "finger"))
    + joint("table", "revolute", "world", "base", "0 0 1", "0 0 1")
    + joint("shoulder", "revolute", "base", "a", "0 0 0.2", "0 0 1")
    + joint("roll", "continuous", "a", "b", "0.3 0 0", "1 0 0", "")
    + joint("slide", "prismatic", "b", "c", "0 0.1 0", "0 1 0")
    + joint("flange", "fixed", "c", "tool0", "0 0 0.1", "0 0 1", "")
    + joint("finger_joint", "prismatic", "c", "finger", "0 0 0", "1 0 0")
    + "</robot>"
)
configurations = arrays(np.float64, 3, elements=st.floats(-1.9, 1.9))


@pytest.fixture(scope="module")
def arm():
    return Kinematics(URDF, "base", "tool0")


def test_chain_limits_and_order_come_from_the_urdf(arm):
    assert arm.joint_names == ("shoulder", "roll", "slide")
    assert arm.lower.tolist() == [-2, -np.inf, -2]
    assert arm.upper.tolist() == [2.5, np.inf, 2.5]
    assert arm.max_velocity.tolist()[0] == 3


def test_forward_is_the_product_of_the_joints_transforms(arm):
    origin = transforms.rotation_exp([0, 0, 0.3]) @ transforms.rotation_exp([0, -0.2, 0])
    origin = origin @ transforms.rotation_exp([0.1, 0, 0])
    q = [0.4, -2.9, 0.25]
    expected = (
        transforms.make(origin, [0, 0, 0.2])
        @ transforms.exp([0, 0, 0, 0, 0, q[0]])
        @ transforms.make(origin, [0.3, 0, 0])
        @ transforms.exp([0, 0, 0, q[1], 0, 0])
        @ transforms.make(origin, [0, 0.1, 0])
        @ transforms.exp([0, q[2], 0, 0, 0, 0])
        @ transforms.make(origin, [0, 0, 0.1])
    )
    assert arm.forward(q) == pytest.approx(expected, abs=1e-12)


@given(configurations)
def test_jacobian_is_the_derivative_of_forward(q):
    arm = Kinematics(URDF, "base", "tool0")
    step = 1e-6
    numeric = [
        transforms.difference(arm.forward(q - e), arm.forward(q + e)) / (2 * step) for e in step * np.eye(arm.size)
    ]
    assert arm.jacobian(q) == pytest.approx(np.transpose(numeric), abs=1e-7)


def test_joints_are_mapped_by_name_whatever_their_order(arm):
    names = ["finger_joint", "slide", "shoulder", "roll"]
    assert arm.positions_from(names, [9.0, 0.3, 0.1, 0.2]).tolist() == [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    ("names", "positions", "reason"),
    [
        (["slide", "shoulder"], [0.0, 0.0], "lacks roll; it has: slide, shoulder"),
        (["slide"], [0.0, 1.0], "1 names but 2 positions"),
        (["slide", "shoulder", "roll"], [0.0, np.nan, 0.0], "not finite for shoulder"),
        ([], [], "lacks shoulder, roll, slide; it has: no joints"),
    ],
)
def test_unusable_joint_states_are_refused_by_name(arm, names, positions, reason):
    with pytest.raises(InvalidInputError, match=reason):
        arm.positions_from(names, positions)


@pytest.mark.parametrize(
    ("urdf", "base", "tip", "reason"),
    [
        ("<robot", "base", "tool0", "not a usable URDF"),
        (URDF, "base", "flange_x", "frame 'flange_x' is not in robot_description; it has: .*tool0"),
        (URDF, "finger", "tool0", "not a descendant"),
        (URDF, "c", "tool0", "no movable joint"),
    ],
)
def test_models_that_do_not_fit_are_refused(urdf, base, tip, reason):
    with pytest.raises(ModelError, match=reason):
        Kinematics(urdf, base, tip)
