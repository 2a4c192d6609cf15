from types import SimpleNamespace

import numpy as np
import pytest

from sl_common.errors import InvalidInputError
from sl_sim.ros.commanding import trajectory_setpoints

NAMES = ("a", "b", "c")


def message(names, *points):
    made = [
        SimpleNamespace(
            positions=list(q), time_from_start=SimpleNamespace(sec=int(t), nanosec=round((t - int(t)) * 1e9))
        )
        for t, q in points
    ]
    return SimpleNamespace(joint_names=list(names), points=made)


def test_joints_are_mapped_by_name():
    (q,) = trajectory_setpoints(message("cab", (0.008, [3, 1, 2])), NAMES, 0.008)
    np.testing.assert_array_equal(q, [1, 2, 3])


def test_points_a_period_apart_are_setpoints_in_order():
    points = [(0.008 * k, [k, k, k]) for k in range(1, 4)]
    assert [q[0] for q in trajectory_setpoints(message("abc", *points), NAMES, 0.008)] == [1, 2, 3]


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (message("ab", (0.008, [1, 2])), "lacks c"),
        (message("abc"), "no points"),
        (message("abc", (0.008, [1, 2])), "2 positions for 3"),
        (message("abc", (0.0, [1, 2, 3]), (1.0, [1, 2, 3])), "one point per control period"),
    ],
)
def test_what_cannot_be_followed_is_refused_with_the_reason(bad, words):
    with pytest.raises(InvalidInputError, match=words):
        trajectory_setpoints(bad, NAMES, 0.008)
