import numpy as np
import pytest

from sl_common.errors import InvalidInputError
from sl_sim import arm
from sl_sim.clockwork import Clockwork
from sl_sim.driver import ArmDriver

MS = 1_000_000
START = np.zeros(6)


def test_states_come_one_period_apart_however_late_the_clock():
    clock = Clockwork(ArmDriver(arm.limits(), START), 1000 * MS)
    stamps = [s for late in (1003, 1009, 1100, 1100, 1101) for s, _ in clock.advance(late * MS)]
    assert stamps == [(1000 + 8 * k) * MS for k in range(1, 13)]


def test_joints_between_states_are_interpolated_and_never_extrapolated():
    driver = ArmDriver(arm.limits(), START, buffer=0.0)
    clock = Clockwork(driver, 0)
    for k in range(50):
        driver.receive(START + 1e-3 * k)
        clock.advance((k + 1) * 8 * MS)
    left, middle, right = clock.at(np.array([200, 204, 208]) * MS)
    np.testing.assert_allclose(middle, 0.5 * (left + right), atol=1e-12)
    assert right[0] > left[0] > 0
    with pytest.raises(InvalidInputError):
        clock.at(np.array([clock.now + 1]))
    with pytest.raises(InvalidInputError):
        clock.at(np.array([-1]))


def test_a_jump_of_the_clock_is_not_made_up_for():
    clock = Clockwork(ArmDriver(arm.limits(), START), 0)
    assert [s for s, _ in clock.advance(3_600_000 * MS)] == [3_600_000 * MS]
    assert clock.skipped == pytest.approx(3600.0)
