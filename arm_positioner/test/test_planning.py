"""Which of many ways the planner takes: the least turn of the camera that keeps clear of singularities."""

import numpy as np
import pytest
from positioner_robots import HOME, kinematics

from arm_positioner.errors import SingularityError, UnreachableError
from arm_positioner.limits import from_urdf
from arm_positioner.planning import Planner
from arm_positioner.singularity import Conditioning, SingularityThresholds
from arm_positioner.trajectory import MotionState, plan
from sl_common import transforms


class Case:
    """A planner of the six-axis arm that starts at ``start``."""

    def __init__(self, start=HOME["six"], **thresholds):
        arm = kinematics("six")
        self.arm = kinematics("six")
        self.limits = from_urdf(
            arm.joint_names, arm.lower, arm.upper, arm.max_velocity, max_acceleration=[2.5], max_jerk=[25.0]
        )
        self.start = np.array(start)
        self.planner = Planner(arm, self.limits, thresholds=SingularityThresholds(**thresholds))

    def choose(self, pose, **options):
        def preview(goal):
            return plan(MotionState.at_rest(self.start), goal, self.limits, period=0.008)

        return self.planner.choose(pose, np.eye(4), self.start, preview, **options)


def roll_between(a, b):
    return np.degrees(transforms.rotation_angle(a[:3, :3].T @ b[:3, :3]))


def towards_the_singular_wrist(case):
    """A pose that the arm reaches with its wrist nearly straight."""
    near = case.start.copy()
    near[4] = -0.03
    return case.arm.forward(near)


def test_the_camera_is_not_turned_where_there_is_no_need():
    case = Case()
    pose = case.arm.forward(case.start + 0.1)
    chosen = case.choose(pose, free_roll=True)
    assert np.allclose(chosen.base_from_camera, pose)
    assert np.allclose(case.arm.forward(chosen.positions), pose, atol=1e-5)
    assert chosen.condition < 40


def test_a_free_roll_only_turns_the_camera_about_its_axis():
    # about an axis that is not the last joint's a turn changes the whole posture
    tilted = transforms.make(transforms.rotation_exp((0.9, 0.0, 0.0)), (0.02, -0.06, 0.05))
    case = Case(slow=6.0, stop=60.0)
    pose = case.arm.forward(case.start) @ tilted

    def preview(goal):
        return plan(MotionState.at_rest(case.start), goal, case.limits, period=0.008)

    strict = case.planner.choose(pose, tilted, case.start, preview)
    free = case.planner.choose(pose, tilted, case.start, preview, free_roll=True)
    assert np.allclose(free.base_from_camera[:3, 3], pose[:3, 3])
    assert np.allclose(free.base_from_camera[:3, 2], pose[:3, 2])
    assert np.allclose(case.arm.forward(free.positions) @ tilted, free.base_from_camera, atol=1e-5)
    assert free.condition <= strict.condition


def test_a_goal_refused_for_a_singularity_is_reached_at_another_roll():
    camera = transforms.make(transforms.rotation_exp((0.9, 0.0, 0.0)), (0.02, -0.06, 0.05))
    case = Case(slow=12.0, stop=25.0)
    pose = towards_the_singular_wrist(case) @ camera

    def preview(goal):
        return plan(MotionState.at_rest(case.start), goal, case.limits, period=0.008)

    near = case.start.copy()
    near[4] = -0.03
    assert Conditioning(case.arm).at(near) > 25
    chosen = case.planner.choose(pose, camera, case.start, preview, free_roll=True)
    assert chosen.condition <= 25
    assert np.allclose(chosen.base_from_camera[:3, 2], pose[:3, 2])


def test_what_no_roll_can_help_is_refused_with_the_first_reason():
    case = Case()
    pose = case.arm.forward(case.start)
    pose[:3, 3] = (3.0, 0.0, 0.0)
    with pytest.raises(UnreachableError, match=r"out of reach .*; no roll of the camera is better"):
        case.choose(pose, free_roll=True)
    case = Case(slow=12.0, stop=25.0)
    pose = towards_the_singular_wrist(case)  # the camera looks along the last joint: rolls change nothing else
    with pytest.raises(SingularityError, match=r"limit 25 \(\d+ at the start, \d+ at the goal\).*; no roll"):
        case.choose(pose, free_roll=True)


def test_the_condition_number_does_not_depend_on_the_unit_of_length():
    arm = kinematics("six")
    conditioning = Conditioning(arm)
    assert 0.2 < conditioning.length < 0.6
    levers = [np.linalg.norm(arm.jacobian(q)[:3], axis=0) for q in np.random.default_rng(1).uniform(-3, 3, (300, 6))]
    assert conditioning.length == pytest.approx(np.sqrt(np.mean(np.square(levers))), rel=0.1)
    gantry = Conditioning(kinematics("gantry"))
    assert gantry.at(HOME["gantry"]) < 20
