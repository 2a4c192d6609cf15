"""The state machine in simulated time: each reason to stop, its status, and what leaves meanwhile."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, target
from hypothesis import strategies as st
from positioner_checks import limit_violations
from positioner_robots import HOME
from positioner_simulation import PERIOD, Simulation, assert_clean, moving, shifted

from arm_positioner.errors import (
    Code,
    InvalidGoalError,
    JointLimitError,
    NotAtRestError,
    PausedError,
    PositionerError,
    SingularityError,
    StaleJointsError,
    UnreachableError,
)
from arm_positioner.singularity import SingularityThresholds
from arm_positioner.task import Kind, Outcome
from sl_common import transforms


@pytest.mark.parametrize("robot", ["six", "seven", "gantry"])
def test_it_reaches_poses_one_after_another(robot):
    sim = Simulation(robot)
    for pose in (shifted(sim, x=0.1, z=0.05), shifted(sim, y=-0.1, rotation=(0, 0.2, 0.1))):
        outcome = sim.finish(sim.supervisor.begin(Kind.POSE, pose, duration=1.5))
        assert outcome.code is Code.REACHED, outcome
        assert np.abs(transforms.difference(sim.camera(), pose)).max() < 1e-5
    assert_clean(sim)
    assert sim.codes == [Code.IDLE, Code.MOVING, Code.REACHED, Code.MOVING, Code.REACHED]


def test_the_hand_eye_transform_places_the_camera():
    sim = Simulation()
    flange_from_camera = transforms.make(transforms.rotation_exp((0.1, -0.2, 1.5)), (0.02, -0.07, 0.05))
    sim.supervisor.flange_from_camera = flange_from_camera
    pose = sim.camera() @ flange_from_camera @ transforms.make(np.eye(3), (0, 0, 0.05))
    assert sim.finish(sim.supervisor.begin(Kind.POSE, pose)).code is Code.REACHED
    assert np.abs(transforms.difference(sim.camera() @ flange_from_camera, pose)).max() < 1e-5


def test_nothing_moves_without_an_order():
    sim = Simulation()
    sim.run(1.0)
    assert len(sim.setpoints) == 1
    assert sim.supervisor.code is Code.IDLE


def test_orders_that_cannot_be_obeyed_are_refused_and_move_nothing():
    sim = Simulation()
    far = shifted(sim)
    far[:3, 3] = (3.0, 0, 0)
    with pytest.raises(UnreachableError, match="out of reach"):
        sim.supervisor.begin(Kind.POSE, far)
    with pytest.raises(InvalidGoalError, match="rigid"):
        sim.supervisor.begin(Kind.POSE, np.full((4, 4), np.nan))
    with pytest.raises(InvalidGoalError, match="duration -1"):
        sim.supervisor.begin(Kind.POSE, shifted(sim), duration=-1.0)
    sim.silent = True
    sim.run(0.2)
    with pytest.raises(StaleJointsError, match=r"0\.2\d+ s old, limit 0.1 s"):
        sim.supervisor.begin(Kind.POSE, shifted(sim))
    sim.supervisor.close()
    with pytest.raises(PausedError, match="shutting down"):
        sim.supervisor.begin(Kind.POSE, shifted(sim))
    sim.run(0.5)
    assert len(sim.setpoints) == 1


def test_it_does_not_start_from_an_arm_that_moves_or_is_outside_its_limits():
    sim = Simulation()
    for _ in range(20):
        sim.offset = sim.offset + 0.001
        sim.step()
    with pytest.raises(NotAtRestError, match=r"moved by 0\.01\d+ within 0.1 s"):
        sim.supervisor.begin(Kind.POSE, shifted(sim))
    outside = Simulation(home=[7.0, *HOME["six"][1:]])
    with pytest.raises(JointLimitError, match=r"joint pan at 7\.0000 is outside"):
        outside.supervisor.begin(Kind.POSE, shifted(outside))


def test_pause_keeps_the_task_and_its_pace():
    sim = Simulation()
    task = moving(sim)
    sim.supervisor.pause(paused=True)
    assert sim.supervisor.code is Code.PAUSED
    sim.run(1.0)
    assert not sim.supervisor.is_moving
    count = len(sim.setpoints)
    sim.run(1.0)
    assert len(sim.setpoints) == count
    with pytest.raises(PausedError, match="~/pause"):
        sim.supervisor.begin(Kind.POSE, shifted(sim))
    sim.supervisor.pause(paused=False)
    begun = sim.time
    assert sim.finish(task).code is Code.REACHED
    assert sim.time - begun > 1.2  # of the 2 s, 0.6 had passed
    assert_clean(sim)


def test_resuming_in_mid_brake_is_continuous():
    sim = Simulation()
    task = moving(sim)
    sim.supervisor.pause(paused=True)
    sim.run(0.05)
    assert sim.supervisor.is_moving
    sim.supervisor.pause(paused=False)
    assert sim.finish(task).code is Code.REACHED
    assert_clean(sim)


@pytest.mark.parametrize("how", ["stop", "cancel", "close"])
def test_ends_by_order_come_after_the_arm_is_at_rest(how):
    sim = Simulation()
    task = moving(sim)
    if how == "cancel":
        sim.supervisor.cancel(task, Outcome(Code.STOPPED, "cancelled"))
    else:
        getattr(sim.supervisor, how)()
    assert task.outcome is None
    assert sim.supervisor.code is Code.STOPPED
    assert sim.finish(task).code is Code.STOPPED
    assert_clean(sim)
    assert "at rest" in sim.supervisor.message


def test_stale_joint_states():
    sim = Simulation()
    task = moving(sim)
    sim.silent = True
    outcome = sim.finish(task)
    assert outcome.code is Code.STALE_JOINTS
    assert "0.10" in outcome.message
    assert "limit 0.1 s" in outcome.message
    assert_clean(sim)


def test_driver_deviation_and_a_new_start_from_where_the_arm_is():
    sim = Simulation()
    task = moving(sim)
    sim.blocked = True
    outcome = sim.finish(task)
    assert outcome.code is Code.DRIVER_DEVIATION
    assert "limit 0.05" in outcome.message
    assert_clean(sim)
    sim.run(0.5)
    sim.setpoints = [sim.q.copy()]  # the driver's setpoint is void after a fault
    sim._pipe = [sim.q.copy()] * 3
    sim.blocked = False
    assert sim.finish(sim.supervisor.begin(Kind.POSE, shifted(sim, x=0.05))).code is Code.REACHED
    assert_clean(sim)


def test_an_arm_moved_by_somebody_else_is_started_from_where_it_is():
    sim = Simulation()
    assert sim.finish(sim.supervisor.begin(Kind.POSE, shifted(sim, x=0.05))).code is Code.REACHED
    sim.run(0.5)
    sim.q = sim.q + 0.02
    sim._pipe, sim.setpoints = [sim.q.copy()] * 3, [sim.q.copy()]
    sim.run(0.5)
    assert sim.finish(sim.supervisor.begin(Kind.POSE, shifted(sim, x=0.05))).code is Code.REACHED
    assert np.abs(sim.setpoints[1] - sim.setpoints[0]).max() < 1e-9
    assert_clean(sim)


def test_a_steady_error_of_the_driver_makes_no_jump_between_motions():
    sim = Simulation(position_tolerance=0.01, orientation_tolerance=0.01)
    sim.offset = np.full(6, 2e-3)
    sim.run(0.3)
    assert sim.finish(sim.supervisor.begin(Kind.POSE, shifted(sim, x=0.05))).code is Code.REACHED
    sim.run(0.3)
    second = len(sim.setpoints)
    assert sim.finish(sim.supervisor.begin(Kind.POSE, shifted(sim, y=0.05))).code is Code.REACHED
    assert np.abs(sim.setpoints[second] - sim.setpoints[second - 1]).max() < 1e-4
    assert limit_violations(np.array(sim.setpoints[1:]), sim.limits, PERIOD) == []


def test_an_arm_that_does_not_arrive_is_reported():
    sim = Simulation()
    sim.run(0.3)
    task = sim.supervisor.begin(Kind.POSE, shifted(sim, x=0.1))
    sim.offset = np.full(6, 0.02)  # within the deviation allowed, but off the target
    outcome = sim.finish(task)
    assert outcome.code is Code.DRIVER_DEVIATION
    assert "mm" in outcome.message


def test_a_lost_cloud_holds_the_arm_and_a_cloud_in_time_releases_it():
    sim = Simulation()
    task = moving(sim, Kind.OBJECT)
    sim.run(0.9)
    assert sim.supervisor.code is Code.LOST_CLOUD
    assert "limit 1 s" in sim.supervisor.message
    sim.run(0.5)
    assert not sim.supervisor.is_moving
    sim.supervisor.confirm(task)
    for _ in range(300):
        sim.step()
        sim.supervisor.confirm(task)
    assert sim.finish(task).code is Code.REACHED
    assert_clean(sim)


def test_a_cloud_lost_for_long_ends_the_task():
    sim = Simulation(lost_timeout=2.0)
    outcome = sim.finish(moving(sim, Kind.OBJECT))
    assert outcome.code is Code.LOST_CLOUD
    assert "given up after 2 s" in outcome.message
    assert_clean(sim)


def test_a_stream_of_targets_is_followed_and_its_end_is_noticed():
    sim = Simulation()
    start = sim.camera()
    task = sim.supervisor.begin(Kind.SERVO, start @ transforms.make(np.eye(3), (0.01, 0, 0)))
    for k in range(100):
        sim.step()
        if k % 4 == 0:
            sim.supervisor.retarget(task, start @ transforms.make(np.eye(3), (0.01 + 1e-3 * k, 0, 0)))
    assert task.outcome is None
    outcome = sim.finish(task)
    assert outcome.code is Code.STALE_TARGET
    assert "limit 0.1 s" in outcome.message
    assert_clean(sim)


def test_a_target_that_cannot_be_followed_holds_the_arm_until_one_can():
    sim = Simulation()
    task = moving(sim, Kind.OBJECT, follow=True)
    far = shifted(sim)
    far[:3, 3] = (3.0, 0, 0)
    sim.supervisor.retarget(task, far)
    assert sim.supervisor.code is Code.UNREACHABLE
    sim.run(0.5)
    assert not sim.supervisor.is_moving
    target = shifted(sim, z=0.03)
    for _ in range(200):
        sim.step()
        sim.supervisor.retarget(task, target)
    assert sim.supervisor.code is Code.FOLLOWING
    assert np.abs(transforms.difference(sim.camera(), target)).max() < 1e-4
    sim.supervisor.stop()
    sim.finish(task)
    assert_clean(sim)


@pytest.mark.parametrize("speed", [0.02, 0.08])
def test_a_moving_object_is_followed_with_bounded_lag(speed):
    sim = Simulation()
    start = sim.camera()

    def target():
        travelled = speed * (sim.time - begun)
        return start @ transforms.make(np.eye(3), (travelled, 0, 0))

    begun = sim.time
    task = sim.supervisor.begin(Kind.OBJECT, start, follow=True)
    lags = []
    for k in range(500):
        sim.step()
        if k % 8 == 0:
            sim.supervisor.retarget(task, target())
        if k > 150:
            lags.append(np.linalg.norm(sim.camera()[:3, 3] - target()[:3, 3]) / speed)
    assert max(lags) < 0.5  # seconds behind
    assert sim.supervisor.code is Code.FOLLOWING
    sim.supervisor.stop()
    sim.finish(task)
    assert_clean(sim)


def test_a_goal_in_a_singularity_is_refused_with_its_condition_number():
    sim = Simulation()
    stretched = np.array([0.2, -1.3, 0.003, -1.9, -1.5, 0.3])
    with pytest.raises((SingularityError, UnreachableError), match=r"condition number|out of reach"):
        sim.supervisor.begin(Kind.POSE, sim.camera(stretched))
    assert len(sim.setpoints) == 1


def test_an_arm_may_leave_a_singularity_it_starts_in():
    sim = Simulation(home=[0.2, -1.3, 0.002, -1.9, -1.5, 0.3])
    assert sim.supervisor.condition() > 100
    task = sim.supervisor.begin(Kind.POSE, sim.camera(HOME["six"]))
    assert sim.finish(task).code is Code.REACHED
    assert Code.SINGULARITY in sim.codes  # slowed down and said so
    assert_clean(sim)


def test_it_slows_down_between_the_thresholds():
    slow, free = (
        Simulation(acceleration=30.0, jerk=1500.0, thresholds=SingularityThresholds(slow=threshold, stop=80.0))
        for threshold in (12.0, 79.0)
    )
    near = HOME["six"].copy()
    near[4] = -0.1  # towards the wrist's singularity
    speeds = []
    for sim in (slow, free):
        task = sim.supervisor.begin(Kind.POSE, sim.camera(near))
        fastest = 0.0
        while task.outcome is None:
            before = sim.q
            sim.step()
            if 40 < sim.supervisor.condition() < 60:
                fastest = max(fastest, np.abs(sim.q - before).max() / PERIOD)
        assert task.outcome.code is Code.REACHED
        assert_clean(sim)
        speeds.append(fastest)
    assert speeds[0] < 0.75 * speeds[1]
    assert Code.SINGULARITY in slow.codes
    assert Code.SINGULARITY not in free.codes


def test_followed_into_a_singularity_it_stops_before():
    sim = Simulation(thresholds=SingularityThresholds(slow=15.0, stop=40.0))
    task = sim.supervisor.begin(Kind.OBJECT, sim.camera(), follow=True)
    worst = 0.0
    for k in range(400):
        near = HOME["six"].copy()
        near[4] += min(0.004 * k, 1.5)
        if k % 8 == 0:
            sim.supervisor.retarget(task, sim.camera(near))
        sim.step()
        worst = max(worst, sim.supervisor.condition())
    assert sim.supervisor.code is Code.SINGULARITY
    assert "limit 40" in sim.supervisor.message
    assert worst < 1.2 * 40
    sim.supervisor.stop()
    sim.finish(task)
    assert_clean(sim)


EVENTS = ["goal", "goal", "goal", "retarget", "pause", "resume", "stop", "silence", "noise", "block", "cloud"]


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.sampled_from(["six", "seven", "gantry"]),
    st.lists(st.tuples(st.integers(5, 120), st.sampled_from(EVENTS), st.integers(0, 2**31)), min_size=3, max_size=14),
)
def test_whatever_happens_the_setpoints_keep_the_limits_and_end_at_rest(robot, events):
    sim = Simulation(robot)
    supervisor = sim.supervisor
    task = None
    for ticks, event, number in events:
        rng = np.random.default_rng(number)
        pose = sim.camera(HOME[robot] + rng.uniform(-0.25, 0.25, sim.q.size))
        try:
            if event == "goal":
                kind = Kind(rng.choice([k.value for k in Kind]))
                task = supervisor.begin(kind, pose, duration=rng.choice([0, 1.0]), follow=bool(rng.random() < 0.5))
            elif event == "retarget" and task is not None:
                supervisor.retarget(task, pose)
            elif event == "cloud" and task is not None:
                supervisor.confirm(task)
            elif event in ("pause", "resume"):
                supervisor.pause(paused=event == "pause")
            elif event == "stop":
                supervisor.stop()
        except PositionerError:
            pass
        sim.silent, sim.blocked = event == "silence", event == "block"
        if event == "block":
            sim.run(0.01 * ticks)
            supervisor.stop()
            sim.run(2.0)
            break
        sim.run(ticks * PERIOD)
    sim.silent = False
    target(float(len(sim.setpoints)), label="setpoints")
    supervisor.close()
    sim.run(3.0)
    assert limit_violations(np.array(sim.setpoints), sim.limits, PERIOD) == []
    assert not supervisor.is_moving
    assert supervisor.task is None
