from dataclasses import replace

import numpy as np
import pytest

from arm_positioner.errors import ObjectGoneError
from arm_positioner.following import TargetFilter
from arm_positioner.servo import ServoGate
from arm_positioner.sight import Sight, Sighting
from arm_positioner.surface import SurfacePatch
from arm_positioner.target import Target, TargetOptions
from sl_common import transforms


def pose(x, angle=0.0):
    return transforms.make(transforms.rotation_exp((0, 0, angle)), (x, 0, 0))


def test_a_steady_motion_is_met_without_lag():
    target = TargetFilter()
    for t in np.arange(0, 2, 0.1):
        target.update(t, pose(0.1 * t, 0.2 * t))
    delta = transforms.difference(target.at(2.05), pose(0.205, 0.41))
    assert np.abs(delta).max() < 2e-3
    assert target.speed == pytest.approx(0.1, rel=0.02)


def test_noise_is_smoothed_and_the_pose_at_rest_unbiased():
    rng = np.random.default_rng(0)
    target, out = TargetFilter(time_constant=0.3), []
    for t in np.arange(0, 20, 0.1):
        target.update(t, pose(rng.normal(scale=1e-3)))
        if t > 2:
            out.append(target.at(t)[0, 3])
    assert np.std(out) < 0.7e-3
    assert abs(np.mean(out)) < 2e-4


def test_a_single_outlier_is_ignored_and_a_real_jump_believed():
    target = TargetFilter(gate=0.1)
    for t in np.arange(0, 1, 0.1):
        target.update(t, pose(0.0))
    assert not target.update(1.0, pose(0.5))
    assert abs(target.at(1.0)[0, 3]) < 1e-6
    assert target.update(1.1, pose(0.0))
    assert not target.update(1.2, pose(0.5))
    assert not target.update(1.3, pose(0.5))
    assert target.update(1.4, pose(0.5))
    assert target.at(1.4)[0, 3] == pytest.approx(0.5)


def test_extrapolation_ends_at_the_horizon_and_speed_is_bounded():
    target = TargetFilter(horizon=0.5, max_speed=0.2, gate=10.0)
    for t in np.arange(0, 2, 0.1):
        target.update(t, pose(1.0 * t))
    assert target.speed <= 0.2 + 1e-9
    assert np.allclose(target.at(9.0), target.at(2.4))


def test_old_measurements_are_ignored():
    target = TargetFilter()
    target.update(1.0, pose(0.1))
    assert not target.update(0.9, pose(0.2))
    with pytest.raises(ValueError, match="no target"):
        TargetFilter().at(0.0)


def test_the_gate_ends_a_stream_until_it_has_been_silent_or_is_opened():
    gate = ServoGate(silence=1.0)
    assert gate.admits(0.0)
    gate.close()
    assert not any(gate.admits(t) for t in np.arange(0.1, 5.0, 0.5))
    assert gate.admits(6.0)
    gate.close()
    assert not gate.admits(6.1)
    gate.open()
    assert gate.admits(6.2)


class Finder:
    """Stands in for find_target: notes what it is asked and answers with a target at ``place``."""

    def __init__(self):
        self.asked, self.gone = [], False

    def __call__(self, points, pose, **question):
        self.asked.append(question)
        if self.gone and question["previous"] is not None:
            raise ObjectGoneError("the object is gone")
        point = np.array([0.1, 0.0, 1.0])
        surface = SurfacePatch(point, np.array([0, 0, -1.0]), np.eye(3), np.eye(3)[:2], 0.05, 50, 1.0, 1e-4)
        return Target(pose, surface, 100, np.array([0.08, 0.01, 1.0]))


def test_an_object_is_kept_between_goals_and_its_place_while_it_is_tracked():
    find = Finder()
    sight = Sight(find=find)
    cloud = Sighting(0.0, np.zeros((1, 3)), np.eye(4))
    sight.look(cloud, TargetOptions())
    sight.look(cloud, TargetOptions())
    assert find.asked[0]["previous"] is None
    assert find.asked[0]["offset"] is None
    assert np.allclose(find.asked[1]["previous"], (0.1, 0, 1))
    assert np.allclose(find.asked[1]["offset"], (0.02, -0.01, 0))
    sight.choose_anew()
    sight.look(cloud, TargetOptions())
    assert find.asked[2]["previous"] is not None
    assert find.asked[2]["offset"] is None
    sight.reset()
    sight.look(cloud, TargetOptions())
    assert find.asked[3]["previous"] is None


def test_a_tracked_object_that_is_gone_is_said_to_be_and_a_new_goal_takes_the_nearest():
    find = Finder()
    sight = Sight(find=find)
    cloud = Sighting(0.0, np.zeros((1, 3)), np.eye(4))
    sight.look(cloud, TargetOptions())
    find.gone = True
    with pytest.raises(ObjectGoneError):
        sight.look(cloud, TargetOptions())
    sight.choose_anew()
    assert sight.look(cloud, TargetOptions()).object_points == 100
    assert find.asked[-1]["previous"] is None


def test_a_place_that_is_taken_is_kept():
    find = Finder()
    sight = Sight(find=find, find_others=lambda *_, **question: [question["previous"]])
    cloud = Sighting(0.0, np.zeros((1, 3)), np.eye(4))
    seen = sight.look(cloud, TargetOptions())
    assert np.allclose(sight.others(cloud, TargetOptions())[0], seen.surface.point)
    surface = replace(seen.surface, point=np.array([0.2, 0.1, 1.0]))
    sight.take(replace(seen, surface=surface))
    sight.look(cloud, TargetOptions())
    assert np.allclose(find.asked[-1]["offset"], (0.12, 0.09, 0.0))
