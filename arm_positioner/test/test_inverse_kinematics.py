import numpy as np
import pytest
from positioner_robots import HOME, URDFS, kinematics

from arm_positioner.errors import UnreachableError
from arm_positioner.inverse_kinematics import InverseKinematics
from sl_common import transforms


def solver(name, margin=0.0):
    arm = kinematics(name)
    return arm, InverseKinematics(arm, arm.lower + margin, arm.upper - margin)


def random_joints(arm, rng):
    return rng.uniform(np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi))


@pytest.mark.parametrize("name", URDFS)
def test_known_poses_are_found_within_the_limits_nearest_first(name):
    arm, ik = solver(name)
    rng = np.random.default_rng(5)
    for _ in range(6):
        truth, current = random_joints(arm, rng), random_joints(arm, rng)
        target = arm.forward(truth)
        solutions = ik.solve(target, current)
        for solution in solutions:
            delta = transforms.difference(arm.forward(solution.positions), target)
            assert np.abs(delta).max() < 2e-6
            assert (solution.positions >= arm.lower).all()
            assert (solution.positions <= arm.upper).all()
        distances = [s.distance for s in solutions]
        assert distances == sorted(distances)


@pytest.mark.parametrize("name", ["six", "gantry"])
def test_a_pose_close_by_is_reached_without_a_change_of_posture(name):
    arm, ik = solver(name)
    rng = np.random.default_rng(6)
    for _ in range(8):
        truth = HOME[name] + rng.normal(scale=0.1, size=arm.size)
        assert np.abs(ik.nearby(arm.forward(truth), HOME[name]).positions - truth).max() < 1e-4
        assert np.abs(ik.solve(arm.forward(truth), HOME[name])[0].positions - truth).max() < 1e-4


def test_it_is_deterministic():
    arm, ik = solver("seven")
    target = arm.forward(HOME["seven"] + 0.4)
    one, two = (ik.solve(target, HOME["seven"]) for _ in range(2))
    assert [s.positions.tolist() for s in one] == [s.positions.tolist() for s in two]


def test_full_turns_are_taken_back_towards_the_current_joints():
    arm, ik = solver("six")
    truth = HOME["six"] - np.array([0.4, 0, 0, 0, 0, 0])
    far = truth + np.array([2 * np.pi - 0.3, 0, 0, 0, 0, 0])
    assert np.allclose(ik.solve(arm.forward(truth), far)[0].positions - far, [0.3, 0, 0, 0, 0, 0], atol=1e-4)


def test_out_of_reach_is_said_with_the_distance():
    arm, ik = solver("six")
    target = arm.forward(HOME["six"])
    target[:3, 3] = (2.0, 0.0, 0.3)
    with pytest.raises(UnreachableError, match=r"\(2.000, 0.000, 0.300\) m is out of reach .* misses it by \d+"):
        ik.solve(target, HOME["six"])
    with pytest.raises(UnreachableError, match="misses"):
        ik.nearby(target, HOME["six"])


def test_limits_are_kept_where_the_pose_would_need_more():
    arm = kinematics("seven")
    truth = HOME["seven"]
    ik = InverseKinematics(arm, np.where(np.arange(7) == 3, truth + 0.3, arm.lower), arm.upper)
    target = arm.forward(truth)
    try:
        found = ik.solve(target, truth)
    except UnreachableError:
        return
    assert all(solution.positions[3] >= truth[3] + 0.3 for solution in found)
