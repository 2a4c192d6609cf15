import numpy as np
import pytest
from positioner_robots import HOME, kinematics

from arm_positioner.errors import SingularityError
from arm_positioner.planning import require_regular
from arm_positioner.singularity import (
    Conditioning,
    SingularityThresholds,
    SingularityWatch,
    condition_number,
    first_violation,
)

LIMITS = SingularityThresholds(slow=40, stop=100, least_speed=0.1)


def test_condition_numbers_of_known_matrices():
    assert condition_number(np.eye(6)) == pytest.approx(1.0)
    assert condition_number(np.diag([1, 1, 1, 1, 1, 0.01])) == pytest.approx(100.0)
    assert np.isinf(condition_number(np.diag([1, 1, 1, 1, 1, 0.0])))
    assert condition_number(np.zeros((3, 6, 7)) + np.eye(6, 7)).shape == (3,)


def test_speed_falls_linearly_between_the_thresholds():
    assert LIMITS.speed(10) == 1.0
    assert LIMITS.speed(70) == pytest.approx(0.55)
    assert LIMITS.speed(np.inf) == pytest.approx(0.1)


def test_the_wrist_of_the_six_axis_arm_is_singular_when_straight():
    conditioning = Conditioning(kinematics("six"))
    path = np.linspace(HOME["six"], np.where(np.arange(6) == 4, 0.0, HOME["six"]), 20)
    conditions = conditioning.along(path)
    assert conditions[0] < 20
    assert conditions[-1] > 1e6
    assert first_violation(conditions, LIMITS) > 10
    with pytest.raises(SingularityError, match=r"along the way the condition number is (\d+|inf), limit 100"):
        require_regular(conditioning, path, LIMITS)
    assert require_regular(conditioning, path[:10], LIMITS) < 100


def test_leaving_is_allowed_returning_is_not():
    assert first_violation(np.array([np.inf, 800, 300, 90, 20]), LIMITS) == -1
    assert first_violation(np.array([800, 300, 290, 305, 90, 20]), LIMITS) == -1
    assert first_violation(np.array([800, 300, 500, 90]), LIMITS) == 2
    assert first_violation(np.array([800, 50, 101]), LIMITS) == 2


def test_the_watch_remembers():
    watch = SingularityWatch(LIMITS)
    assert watch.allows(500)
    assert watch.allows(400)
    assert not watch.allows(480)
