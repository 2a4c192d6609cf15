import numpy as np
import pytest

from arm_positioner.errors import InvalidGoalError
from arm_positioner.limits import JointLimits, command_order, from_urdf

NAMES = ("a", "b")


def urdf(**kwargs):
    defaults = {"max_acceleration": [2.0], "max_jerk": [20.0, 30.0]}
    return from_urdf(NAMES, [-1, -2], [1, 2], [3.0, np.inf], **(defaults | kwargs))


def test_the_smaller_velocity_holds_and_one_number_serves_all_joints():
    limits = urdf(max_velocity=[2.0], velocity_scale=0.5)
    assert limits.velocity.tolist() == [1.5, 2.0]
    assert limits.acceleration.tolist() == [2.0, 2.0]
    assert limits.jerk.tolist() == [20.0, 30.0]
    assert not limits.lower.flags.writeable


@pytest.mark.parametrize(
    ("kwargs", "said"),
    [
        ({"max_velocity": []}, "joint b: velocity limit inf"),
        ({"max_velocity": [1.0, 2.0, 3.0]}, "max_velocity has 3 numbers, expected 1 or 2"),
        ({"max_velocity": [1.0], "max_jerk": [0.0]}, "joint a: jerk limit 0 must be positive"),
        ({"max_velocity": [1.0], "max_acceleration": [float("nan")]}, "NaN"),
    ],
)
def test_limits_that_make_no_sense_are_refused_with_the_number(kwargs, said):
    with pytest.raises(InvalidGoalError, match=said):
        urdf(**kwargs)


def test_an_empty_range_is_refused():
    with pytest.raises(InvalidGoalError, match="lower limit 1 is not below upper limit 1"):
        JointLimits(("a",), [1.0], [1.0], [1.0], [1.0], [1.0])


def test_outside_names_the_joint_and_inside_keeps_a_margin():
    limits = urdf(max_velocity=[1.0])
    assert limits.outside([0.0, 2.0]) == ""
    assert "joint b at 2.1000" in limits.outside([0.0, 2.1])
    lower, upper = limits.inside(0.1)
    assert lower.tolist() == [-0.9, -1.9]
    assert upper.tolist() == [0.9, 1.9]
    assert limits.inside(9.0)[0].tolist() == [-0.5, -1.0]


def test_command_order_maps_by_name():
    assert command_order(NAMES, ()).tolist() == [0, 1]
    assert command_order(NAMES, ("b", "a")).tolist() == [1, 0]
    for wrong in (("a",), ("a", "a"), ("a", "c")):
        with pytest.raises(InvalidGoalError, match="parameter joints"):
            command_order(NAMES, wrong)
