"""Whatever is asked of a stream, at whatever moment: every setpoint inside all limits, continuous, ending at rest."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from positioner_checks import limit_violations

from arm_positioner.errors import InvalidGoalError, JointLimitError, PositionerError
from arm_positioner.limits import JointLimits
from arm_positioner.stream import SetpointStream
from arm_positioner.trajectory import MotionState

PERIOD = 0.008


def make_limits(rng, n):
    return JointLimits(
        tuple(f"j{i}" for i in range(n)),
        -rng.uniform(0.2, 3, n),
        rng.uniform(0.2, 3, n),
        rng.uniform(0.3, 3, n),
        rng.uniform(0.5, 8, n),
        rng.uniform(4, 100, n),
    )


def run(stream, ticks):
    out = []
    for _ in range(ticks):
        state = stream.advance()
        if state is None:
            break
        out.append(state.position)
    return out


EVENT = st.tuples(
    st.integers(1, 60),  # ticks until the event
    st.sampled_from(["move", "move", "move", "edge", "slow", "stop"]),
    st.integers(0, 2**31),
)


@settings(max_examples=80, deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 7), st.lists(EVENT, min_size=1, max_size=12))
def test_any_sequence_of_orders_keeps_every_limit_and_ends_at_rest(seed, n, events):
    rng = np.random.default_rng(seed)
    limits = make_limits(rng, n)
    stream = SetpointStream(limits, PERIOD)
    start = rng.uniform(limits.lower, limits.upper)
    stream.start(start)
    setpoints = [start]
    for ticks, event, number in events:
        order = np.random.default_rng(number)
        try:
            if event == "stop":
                stream.stop()
            elif event == "edge":  # goals at the very limits
                stream.move(np.where(order.random(n) < 0.5, limits.lower, limits.upper), duration=order.uniform(0, 2))
            else:
                speed = order.uniform(0.05, 1) if event == "slow" else 1.0
                stream.move(order.uniform(limits.lower, limits.upper), duration=order.choice([0, 0.5, 3]), speed=speed)
        except JointLimitError:
            pass  # refused: the motion under way goes on
        setpoints += run(stream, ticks)
    stream.stop()
    setpoints += run(stream, 100_000)
    assert not stream.is_moving
    assert stream.fault == ""
    assert limit_violations(np.array(setpoints), limits, PERIOD) == []
    assert stream.state.is_at_rest
    assert np.array_equal(setpoints[-1], stream.state.position)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.0, 0.5))
def test_the_outlook_is_within_the_limits_wherever_it_is_cut_off(seed, horizon):
    rng = np.random.default_rng(seed)
    limits = make_limits(rng, 6)
    stream = SetpointStream(limits, PERIOD)
    stream.start(rng.uniform(limits.lower, limits.upper))
    sent = [stream.state.position]
    stream.move(rng.uniform(limits.lower, limits.upper))
    sent += run(stream, int(rng.integers(1, 150)))
    ahead = [state.position for state in stream.outlook(horizon)]
    if stream.is_moving:
        assert stream.outlook(horizon)[-1].is_at_rest
        following = stream.advance()
        assert np.allclose(following.position, ahead[0], atol=1e-12)
    assert limit_violations(np.array(sent + ahead), limits, PERIOD) == []


def simple():
    limits = JointLimits(("a", "b"), [-1, -1], [1, 1], [1, 1], [2, 2], [20, 20])
    stream = SetpointStream(limits, PERIOD)
    return stream


def test_the_first_setpoint_is_the_start_and_the_duration_is_kept():
    stream = simple()
    stream.start([0.1, 0.2])
    stream.move([0.5, 0.2], duration=4.0)
    setpoints = run(stream, 10_000)
    assert np.array_equal(setpoints[0], [0.1, 0.2])
    assert len(setpoints) == 1 + round(4.0 / PERIOD)
    assert np.allclose(setpoints[-1], [0.5, 0.2], rtol=0, atol=1e-12)


def test_a_short_duration_is_lengthened_to_what_the_limits_allow():
    stream = simple()
    stream.start([-0.9, 0.0])
    assert stream.move([0.9, 0.0], duration=0.1).duration > 1.8


def test_goals_outside_the_limits_are_refused_and_the_motion_goes_on():
    stream = simple()
    stream.start([0.0, 0.0])
    stream.move([0.5, 0.5])
    run(stream, 20)
    with pytest.raises(JointLimitError, match=r"joint b at 1.1000 is outside its limits -1.0000 to 1.0000"):
        stream.move([0.0, 1.1])
    with pytest.raises(InvalidGoalError, match="finite"):
        stream.move([0.0, float("nan")])
    run(stream, 10_000)
    assert np.allclose(stream.state.position, [0.5, 0.5])


def test_it_does_not_start_outside_the_limits_or_in_mid_motion():
    stream = simple()
    with pytest.raises(PositionerError, match="not started"):
        stream.move([0, 0])
    with pytest.raises(JointLimitError, match="cannot start"):
        stream.start([1.01, 0])
    stream.start([0.0, 0.0])
    stream.move([0.5, 0.5])
    run(stream, 10)
    with pytest.raises(PositionerError, match="stop it first"):
        stream.start([0.0, 0.0])


@pytest.mark.parametrize("poison", ["nan", "jump", "beyond"])
def test_a_trajectory_gone_wrong_is_held_back_and_the_arm_braked(monkeypatch, poison):
    stream = simple()
    stream.start([0.0, 0.0])
    trajectory = stream.move([0.9, 0.9], duration=1.5)
    sent = [np.zeros(2), *run(stream, 60)]
    good = trajectory.at
    bad = {"nan": np.full(2, np.nan), "jump": np.array([0.05, 0.0]), "beyond": np.array([2.0, 0.0])}[poison]

    def wrong(time):
        state = good(time)
        return MotionState(state.position + bad, state.velocity, state.acceleration)

    monkeypatch.setattr(trajectory, "at", wrong)
    sent += run(stream, 10_000)
    assert stream.fault
    assert stream.state.is_at_rest
    assert limit_violations(np.array(sent), stream.limits, PERIOD) == []
