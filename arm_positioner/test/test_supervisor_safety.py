"""What must not happen: motion after a stop, through a pause, by defects, or by joint states that cannot be true."""

import numpy as np
import pytest
from positioner_simulation import PERIOD, Simulation, assert_clean, moving, shifted

from arm_positioner.errors import Code, NotAtRestError, PausedError, SupersededError
from arm_positioner.task import Kind


def test_a_stop_or_a_newer_order_voids_one_that_has_not_begun():
    sim = Simulation()
    order = sim.supervisor.order()
    sim.supervisor.stop()
    sim.run(0.1)
    with pytest.raises(SupersededError, match="~/stop"):
        sim.supervisor.begin(Kind.POSE, shifted(sim, x=0.05), order=order)
    older, newer = sim.supervisor.order(), sim.supervisor.order()
    task = sim.supervisor.begin(Kind.POSE, shifted(sim, x=0.05), order=newer)
    with pytest.raises(SupersededError, match="newer order"):
        sim.supervisor.begin(Kind.POSE, shifted(sim, y=0.05), order=older)
    assert sim.finish(task).code is Code.REACHED
    again = sim.supervisor.begin(Kind.POSE, shifted(sim, z=0.02), order=newer)  # a correction of the same order
    assert sim.finish(again).code is Code.REACHED
    assert_clean(sim)


def test_a_pause_holds_through_a_stop_and_while_the_arm_brakes():
    sim = Simulation()
    task = moving(sim)
    sim.supervisor.stop()
    sim.supervisor.pause(paused=True)
    assert sim.finish(task).code is Code.STOPPED
    sim.run(0.1)
    assert sim.supervisor.code is Code.PAUSED
    sim.supervisor.stop()
    sim.run(0.1)
    with pytest.raises(PausedError, match="~/pause"):
        sim.supervisor.begin(Kind.POSE, shifted(sim))
    sim.supervisor.pause(paused=False)
    assert sim.finish(sim.supervisor.begin(Kind.POSE, shifted(sim, x=0.02))).code is Code.REACHED
    assert_clean(sim)


def test_a_pause_taken_back_in_mid_brake_does_not_revive_a_stopped_task():
    sim = Simulation()
    task = moving(sim)
    sim.supervisor.stop()
    sim.supervisor.pause(paused=True)
    sim.supervisor.pause(paused=False)
    assert sim.finish(task).code is Code.STOPPED
    sim.run(0.5)
    assert not sim.supervisor.is_moving
    assert_clean(sim)


def test_a_defect_in_the_watch_stops_the_arm_within_its_limits(monkeypatch):
    sim = Simulation()
    task = moving(sim)
    monkeypatch.setattr("arm_positioner.watchdog.lost_cloud", lambda *_: 1 / 0)
    outcome = sim.finish(task)
    assert outcome.code is Code.INVALID_INPUT
    assert "ZeroDivisionError" in outcome.message
    assert_clean(sim)


def test_when_setpoints_have_ended_tasks_end_and_none_begins():
    sim = Simulation()
    task = moving(sim)
    sim.supervisor.fail("setpoints have ended")
    assert task.outcome is not None
    assert task.outcome.code is Code.INVALID_INPUT
    with pytest.raises(PausedError):
        sim.supervisor.begin(Kind.POSE, shifted(sim))


@pytest.mark.parametrize("jump", [0.06, 0.5, 2 * np.pi])
@pytest.mark.parametrize("lasting", [1, 100])
def test_joint_states_that_jump_stop_the_arm_within_its_limits(jump, lasting):
    sim = Simulation()
    task = moving(sim)
    sim.offset = np.eye(6)[2] * jump
    sim.run(lasting * PERIOD)
    sim.offset = np.zeros(6)
    outcome = sim.finish(task)
    assert outcome.code is Code.DRIVER_DEVIATION
    assert "joint elbow" in outcome.message
    assert_clean(sim)


def test_an_arm_whose_joint_states_have_just_jumped_is_not_started():
    sim = Simulation()
    sim.offset = np.eye(6)[2] * 0.3
    sim.run(2 * PERIOD)
    with pytest.raises(NotAtRestError, match=r"joint elbow moved by 0\.3"):
        sim.supervisor.begin(Kind.POSE, shifted(sim))
    assert len(sim.setpoints) == 1


def test_joint_states_from_the_past_are_not_believed():
    sim = Simulation()
    task = moving(sim)
    for k in range(100):
        sim.supervisor.joint_state(sim.time - 10.0 + k * PERIOD, np.zeros(6))
    assert sim.finish(task).code is Code.REACHED
    assert_clean(sim)
