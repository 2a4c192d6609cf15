import numpy as np
import pytest

from sl_common.errors import InvalidInputError
from sl_sim import arm
from sl_sim.arm import Servo
from sl_sim.driver import ArmDriver

LIMITS = arm.limits()
START = np.array([0.1, -1.5, 1.5, 0.0, 0.3, -0.2])
T = 0.008


def gentle(n=250, size=0.05):
    s = np.linspace(0, 1, n)[:, None]
    return START + size * s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)


def driver():
    return ArmDriver(LIMITS, START, period=T, buffer=5 * T, timeout=20 * T)


def test_a_stream_is_followed_setpoint_by_setpoint_after_the_buffer():
    d, path, references = driver(), gentle(), []
    for q in path:
        d.receive(q)
        d.step()
        references.append(d.reference.copy())
    for _ in range(60):
        d.step()
        references.append(d.reference.copy())
    moved = [r for k, r in enumerate(references) if k == 0 or not np.array_equal(r, references[k - 1])]
    np.testing.assert_array_equal(np.array(moved[-len(path) + 1 :]), path[1:])
    np.testing.assert_allclose(d.servo.positions, path[-1], atol=1e-7)
    report = d.report()
    assert report["violations_total"] == report["gaps"] == report["stopped_while_moving"] == 0
    assert report["first_setpoint_jumps"] == 0
    assert (report["setpoints"], report["streams"]) == (len(path), 1)


def test_late_setpoints_are_taken_up_by_the_buffer_and_longer_pauses_are_gaps():
    for pause, gaps in ((4, 0), (12, 1)):
        d, path = driver(), gentle()
        for k, q in enumerate(path):
            d.receive(q)
            if k == 100:
                for _ in range(pause):
                    d.step()
            d.step()
        assert d.report()["gaps"] == gaps
        assert d.report()["violations_total"] == 0


def test_a_stream_that_ends_in_motion_is_counted_and_the_arm_holds_its_last_setpoint():
    d, path = driver(), gentle()
    for q in path[:120]:
        d.receive(q)
        d.step()
    for _ in range(200):
        d.step()
    assert d.report()["stopped_while_moving"] == 1
    np.testing.assert_allclose(d.servo.positions, path[119], atol=1e-6)


@pytest.mark.parametrize(("offset", "jumps"), [(1.9e-3, 0), (2.1e-3, 1)])
def test_the_first_setpoint_is_compared_with_the_joints(offset, jumps):
    d = driver()
    d.receive(START + np.array([0, 0, offset, 0, 0, 0]))
    assert d.report()["first_setpoint_jumps"] == jumps
    assert d.report()["largest_jump"] == pytest.approx(offset)


def test_a_second_stream_begins_after_the_pause():
    d = driver()
    for _ in range(3):
        d.receive(START)
    for _ in range(60):
        d.step()
    d.receive(START + 0.5)
    assert d.report()["streams"] == 2
    assert d.report()["first_setpoint_jumps"] == 1
    assert d.report()["violations_total"] == 0


@pytest.mark.parametrize("bad", [np.zeros(5), np.zeros(7), np.array([0, 0, np.nan, 0, 0, 0]), np.full(6, np.inf)])
def test_unusable_setpoints_are_refused_and_move_nothing(bad):
    d = driver()
    with pytest.raises(InvalidInputError):
        d.receive(bad)
    for _ in range(20):
        d.step()
    np.testing.assert_array_equal(d.servo.positions, START)
    assert d.report()["refused"] == 1
    assert d.report()["streams"] == 0


def test_reset_forgets_everything():
    d = driver()
    for q in gentle()[:60] + 0.3:
        d.receive(q)
        d.step()
    d.reset(START)
    np.testing.assert_array_equal(d.step(), START)
    assert d.report() == driver().report()


def test_the_servo_lags_a_ramp_by_its_time_constant_and_settles_exactly():
    servo, speed, bandwidth = Servo(np.zeros(1), 80.0), 0.4, 80.0
    for k in range(1, 400):
        servo.follow(np.array([speed * k * T]), T)
    lag = speed * 399 * T - servo.positions[0]
    assert lag == pytest.approx(2 / bandwidth * speed, rel=0.1)
    for _ in range(200):
        servo.follow(np.array([1.0]), T)
    assert servo.positions[0] == 1.0
    assert servo.velocities[0] == 0.0
