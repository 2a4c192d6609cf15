import numpy as np
import pytest

from arm_positioner.guard import SetpointGuard
from arm_positioner.limits import JointLimits
from arm_positioner.trajectory import MotionState, plan

PERIOD = 0.008
LIMITS = JointLimits(("a", "b"), [-1, -1], [1, 1], [0.5, 0.5], [2, 2], [20, 20])


def feed(guard, limits=LIMITS, goal=(0.6, -0.6), steps=120):
    """Feed the guard a motion and return the next state of it."""
    trajectory = plan(MotionState.at_rest(np.zeros(2)), goal, limits, period=PERIOD)
    guard.reset(np.zeros(2))
    for k in range(1, steps):
        state = trajectory.at(k * PERIOD)
        assert guard.violation(state) == ""
        guard.accept(state)
    return trajectory.at(steps * PERIOD)


def test_nothing_leaves_before_the_start():
    assert "before the stream has started" in SetpointGuard(LIMITS, PERIOD).violation(MotionState.at_rest([0, 0]))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s: MotionState(s.position * np.nan, s.velocity, s.acceleration), "not finite"),
        (lambda s: MotionState(s.position, s.velocity * np.inf, s.acceleration), "not finite"),
        (lambda s: MotionState(s.position + np.array([0, -1.0]), s.velocity, s.acceleration), "joint b at -1"),
        (lambda s: MotionState(s.position + np.array([1e-4, 0]), s.velocity, s.acceleration), "joint a: "),
        (lambda s: MotionState(s.position, s.velocity + np.array([0.05, 0]), s.acceleration), "claimed velocity"),
        (lambda s: MotionState(s.position, s.velocity, s.acceleration + np.array([0, 0.9])), "claimed acceleration"),
    ],
)
def test_each_kind_of_wrong_setpoint_is_named(change, said):
    guard = SetpointGuard(LIMITS, PERIOD)
    state = feed(guard)
    assert guard.violation(state) == ""
    assert said in guard.violation(change(state))


@pytest.mark.parametrize("kind", ["velocity", "acceleration", "jerk"])
def test_a_plan_with_other_limits_is_caught(kind):
    looser = LIMITS.scaled(**{kind: 1.3})
    guard = SetpointGuard(LIMITS, PERIOD)
    trajectory = plan(MotionState.at_rest(np.zeros(2)), (0.6, -0.6), looser, period=PERIOD)
    guard.reset(np.zeros(2))
    said = ""
    for k in range(1, 300):
        state = trajectory.at(k * PERIOD)
        said = guard.violation(state)
        if said:
            break
        guard.accept(state)
    assert kind in said


def test_a_state_that_cannot_stop_before_the_limit_is_caught():
    wide = JointLimits(LIMITS.names, [-9, -9], [9, 9], LIMITS.velocity, LIMITS.acceleration, LIMITS.jerk)
    guard = SetpointGuard(LIMITS, PERIOD)
    trajectory = plan(MotionState.at_rest(np.zeros(2)), (5.0, 0.0), wide, period=PERIOD)
    guard.reset(np.zeros(2))
    for k in range(1, 2000):
        state = trajectory.at(k * PERIOD)
        said = guard.violation(state)
        if said:
            break
        guard.accept(state)
    assert "cannot be stopped in time: joint a" in said
    assert guard.last.position[0] < 1.0
