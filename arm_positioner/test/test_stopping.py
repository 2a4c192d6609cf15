import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from arm_positioner.limits import JointLimits
from arm_positioner.stopping import stopping_range
from arm_positioner.trajectory import MotionState, brake

UNIT = st.floats(-1, 1)


@settings(max_examples=150, deadline=None)
@given(UNIT, UNIT, st.floats(0.3, 10), st.floats(1, 100))
def test_the_closed_form_agrees_with_the_planned_stop(v, a, acceleration, jerk):
    limits = JointLimits(("j",), [-np.inf], [np.inf], [3.0], [acceleration], [jerk])
    state = MotionState(np.array([0.4]), np.array([3 * v]), np.array([acceleration * a]))
    trajectory = brake(state, limits)
    position, velocity, _ = trajectory.sample(max(trajectory.duration / 400, 1e-6))
    low, high = stopping_range(state.position, state.velocity, state.acceleration, limits)
    step = np.abs(velocity).max() * trajectory.duration / 400 + 1e-9
    assert abs(low[0] - position.min()) < step
    assert abs(high[0] - position.max()) < step
    assert low[0] - 1e-8 <= trajectory.end[0] <= high[0] + 1e-8


def test_a_joint_at_rest_stays_where_it_is():
    limits = JointLimits(("j",), [-1.0], [1.0], [1.0], [1.0], [1.0])
    low, high = stopping_range(np.array([0.3]), np.zeros(1), np.zeros(1), limits)
    assert low[0] == high[0] == 0.3


def test_it_broadcasts_over_a_path():
    limits = JointLimits(("a", "b"), [-1, -1], [1, 1], [1, 1], [2, 2], [20, 20])
    low, high = stopping_range(np.zeros((5, 2)), np.full((5, 2), 0.5), np.zeros((5, 2)), limits)
    assert low.shape == high.shape == (5, 2)
    # v^2 / 2a plus what the jerk limit adds: v a / 2j
    assert np.allclose(high, 0.5**2 / 4 + 0.5 * 2 / 40)
