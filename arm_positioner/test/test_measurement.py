import numpy as np

from arm_positioner.measurement import CommandHistory, MeasuredJoints


def test_rest_is_told_from_motion_over_a_window():
    joints = MeasuredJoints(window=0.1, rest_motion=1e-3)
    assert joints.newest is None
    assert joints.rest_position() is None
    for k in range(40):
        joints.add(0.01 * k, [0.5 + 1e-4 * (-1) ** k])
    assert np.allclose(joints.rest_position(), 0.5, atol=2e-5)
    assert joints.rest_position(since=0.35) is None  # the window would begin before
    for k in range(40, 50):
        joints.add(0.01 * k, [0.5 + 1e-3 * (k - 40)])
    assert joints.rest_position() is None
    assert joints.motion()[0] > 5e-3


def test_one_state_does_not_tell_rest_and_old_ones_are_dropped():
    joints = MeasuredJoints()
    joints.add(1.0, [0.1])
    assert joints.motion() is None
    joints.add(0.5, [9.0])
    assert joints.newest.tolist() == [0.1]
    assert joints.newest_time == 1.0


def test_a_lagging_driver_follows_and_a_standing_one_does_not():
    history = CommandHistory(lag=0.2)
    for k in range(200):
        history.add(0.01 * k, np.array([0.01 * k]))  # 1 rad/s
    assert history.deviation(1.99, np.array([1.85]))[0] == 0.0
    assert np.isclose(history.deviation(1.99, np.array([1.5]))[0], 0.28, atol=0.02)
    assert np.isclose(history.deviation(1.99, np.array([2.1]))[0], 0.11, atol=1e-9)


def test_at_rest_the_last_setpoint_counts_for_ever():
    history = CommandHistory(lag=0.2)
    assert history.deviation(5.0, np.array([3.0]))[0] == 0.0
    history.add(0.0, np.array([1.0]))
    assert np.isclose(history.deviation(100.0, np.array([1.1]))[0], 0.1)
