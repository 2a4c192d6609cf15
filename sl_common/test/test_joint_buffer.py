import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sl_common.errors import InvalidInputError
from sl_common.joint_buffer import Gap, JointBuffer, TooEarly, TooLate

MS = 1_000_000


def filled(stamps_ms, **options):
    buffer = JointBuffer(**options)
    for t in stamps_ms:
        buffer.add(t * MS, [t, -2.0 * t])
    return buffer


@given(st.permutations(range(0, 400, 8)), st.integers(0, 392 * MS))
def test_interpolates_linearly_whatever_the_order_of_arrival(stamps, query):
    q = filled(stamps).at(query)
    assert q == pytest.approx([query / MS, -2 * query / MS])


def test_nothing_is_extrapolated():
    buffer = filled([100, 108])
    with pytest.raises(TooLate, match=r"0\.002 s after"):
        buffer.at(110 * MS)
    with pytest.raises(TooEarly, match=r"0\.001 s before"):
        buffer.at(99 * MS)
    with pytest.raises(TooLate, match="no joint state"):
        JointBuffer().at(0)


def test_a_gap_is_refused_but_a_stamp_on_its_edge_is_exact():
    buffer = filled([0, 300], max_gap=0.1)
    with pytest.raises(Gap, match=r"0\.300 s apart, limit 0\.100 s"):
        buffer.at(150 * MS)
    assert buffer.at(300 * MS) == pytest.approx([300, -600])


def test_old_states_leave_and_a_restarted_clock_clears():
    buffer = filled(range(0, 6000, 10), horizon=1.0)
    assert len(buffer) == 101
    buffer.add(5 * MS, [5.0, 5.0])
    assert len(buffer) == 1
    assert buffer.newest[0] == 5 * MS


def test_bad_positions_are_refused_and_lose_nothing():
    buffer = filled([0, 10])
    with pytest.raises(InvalidInputError, match="not finite"):
        buffer.add(20 * MS, [np.nan, 0.0])
    with pytest.raises(InvalidInputError, match="3 joint positions, expected 2"):
        buffer.add(20 * MS, [0.0, 0.0, 0.0])
    assert buffer.at(5 * MS) == pytest.approx([5, -10])
