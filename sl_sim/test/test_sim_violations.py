import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruckig import InputParameter, OutputParameter, Result, Ruckig

from sl_sim import arm
from sl_sim.violations import KINDS, ViolationCounter

LIMITS = arm.limits()
T = 0.008
JUST = 1e-6


def judge(stream):
    counter = ViolationCounter(LIMITS, T)
    counter.start(stream[0])
    for q in stream:
        counter.add(q)
    return counter.found


def along(joint, values, offset=0.0):
    stream = np.zeros((len(values), 6))
    stream[:, joint] = offset + np.asarray(values)
    return stream


def ramped(kind, size, joint):
    """A stream whose `kind` of derivative reaches size, higher ones kept small."""
    if kind == "jerk":
        jerk = np.array([0.0] * 4 + [size, -size, -size, size] + [0.0] * 4)
        return along(joint, np.cumsum(np.cumsum(np.cumsum(jerk) * T) * T) * T)
    rise = 0.9 * LIMITS.jerk[joint] * T if kind == "acceleration" else 0.9 * LIMITS.acceleration[joint] * T
    steps = int(np.ceil(size / rise))
    up = size * np.arange(1, steps + 1) / steps
    plateau = np.concatenate([[0.0] * 3, up, [size] * 3, up[::-1], [0.0] * 3])
    if kind == "acceleration":
        velocity = np.cumsum(plateau) * T
        return along(joint, np.cumsum(velocity) * T)
    smooth = np.convolve(plateau, np.full(40, 1 / 40))  # keeps jerk and acceleration small, the plateau below its size
    hold = np.concatenate([smooth[: np.argmax(smooth) + 1], [size] * 5])
    return along(joint, np.cumsum(hold) * T)


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("kind", ["velocity", "acceleration", "jerk"])
def test_just_inside_counts_nothing_of_that_kind_and_just_outside_does(kind, joint):
    limit = getattr(LIMITS, kind)[joint]
    inside, outside = judge(ramped(kind, limit * (1 - JUST), joint)), judge(ramped(kind, limit * (1 + JUST), joint))
    assert inside.counts[kind] == 0
    assert inside.worst[kind] == pytest.approx(1 - JUST, abs=2e-7)
    assert outside.counts[kind] > 0
    assert outside.worst[kind] == pytest.approx(1 + JUST, abs=2e-7)


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("end", ["lower", "upper"])
def test_position_limits(joint, end):
    bound = getattr(LIMITS, end)[joint]
    for factor, count in ((1 - 1e-9, 0), (1.0, 0), (1 + 1e-9, 2)):
        assert judge(along(joint, [bound * factor] * 2)).counts["position"] == count


def ruckig_stream(seed):
    rng = np.random.default_rng(seed)
    planner, given_, out = Ruckig(6, T), InputParameter(6), OutputParameter(6)
    given_.current_position, given_.target_position = rng.uniform(-1, 1, (2, 6)).tolist()
    given_.max_velocity, given_.max_acceleration = LIMITS.velocity.tolist(), LIMITS.acceleration.tolist()
    given_.max_jerk = LIMITS.jerk.tolist()
    stream = [np.array(given_.current_position)]
    result = Result.Working
    while result == Result.Working:
        result = planner.update(given_, out)
        stream.append(np.array(out.new_position))
        out.pass_to_input(given_)
    return np.array(stream)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_a_time_optimal_motion_at_the_limits_is_inside_and_one_faster_is_not(seed):
    stream = ruckig_stream(seed)
    found = judge(stream)
    assert found.total == 0, found
    assert max(found.worst[kind] for kind in KINDS[1:]) > 0.95
    assert judge(stream * 1.1).total > 0


def test_a_jump_and_nan_are_seen():
    found = judge(along(2, [0, 0, 0.1, 0.1]))
    assert found.counts["velocity"] == 1
    assert found.counts["jerk"] > 0
    counter = ViolationCounter(LIMITS, T)
    counter.start(np.zeros(6))
    assert counter.add(np.array([0, 0, np.nan, 0, 0, 0])) == ("not_finite",)
    assert counter.found.total == 1
    assert counter.add(np.zeros(6)) == ()
