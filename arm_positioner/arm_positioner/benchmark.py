"""How long the parts of a control period take."""

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from arm_positioner.errors import PositionerError
from arm_positioner.inverse_kinematics import InverseKinematics
from arm_positioner.limits import JointLimits, from_urdf
from arm_positioner.planning import Planner
from arm_positioner.stream import SetpointStream
from arm_positioner.supervisor import Supervisor
from arm_positioner.target import find_target
from arm_positioner.task import Kind
from sl_common import transforms
from sl_common.kinematics import Kinematics

Array = NDArray[np.float64]
Row = tuple[str, float, str, float]

_PERIOD = 1 / 125


def benchmark(urdf_xml: str, *, base_frame: str = "base_link", flange_frame: str = "tool0") -> list[Row]:
    """Measure on this machine, single-threaded, about ten seconds.

    Args:
        urdf_xml: The arm.
        base_frame: Its base.
        flange_frame: Its flange.

    Returns rows (name, value, unit, limit); a value above its limit is too slow for a stream of 125 setpoints a second.
    """
    arm = Kinematics(urdf_xml, base_frame, flange_frame)
    limits = from_urdf(
        arm.joint_names,
        arm.lower,
        arm.upper,
        arm.max_velocity,
        max_velocity=[3.0],
        max_acceleration=[2.5],
        max_jerk=[25.0],
    )
    rng = np.random.default_rng(0)
    low, high = np.maximum(limits.lower, -1.5), np.minimum(limits.upper, 1.5)
    joints = [rng.uniform(low, high) for _ in range(30)]
    solver = InverseKinematics(arm, limits.lower, limits.upper)
    follow: list[Callable[[], object]] = [
        partial(_quietly, partial(solver.nearby, arm.forward(q), q + rng.normal(scale=0.03, size=q.size)))
        for q in joints
    ]
    search: list[Callable[[], object]] = [
        partial(_quietly, partial(solver.solve, arm.forward(q), joints[0])) for q in joints[:10]
    ]
    tick = _ticks(Kinematics(urdf_xml, base_frame, flange_frame), Planner(arm, limits), limits)
    replanning = _replans(limits, joints)
    cloud, row, col = _cloud()
    camera = transforms.identity()
    fits: list[Callable[[], object]] = [lambda: find_target(cloud, camera, row=row, col=col)] * 10
    return [
        ("setpoint with all checks, median", _median(tick), "ms", 2.0),
        ("setpoint with all checks, 99 %", float(np.percentile(tick, 99)), "ms", 1e3 * _PERIOD),
        ("new trajectory in mid-motion, median", _median(replanning), "ms", 4.0),
        ("inverse kinematics nearby, median", _median(_time(follow)), "ms", 10.0),
        ("inverse kinematics from 25 starts, median", _median(_time(search)), "ms", 500.0),
        (f"target from {len(cloud)} points, median", _median(_time(fits)), "ms", 100.0),
    ]


def _quietly(call: Callable[[], object]) -> None:
    """Time failures like successes: a pose near a limit may have no solution."""
    try:
        call()
    except PositionerError:
        return


def _time(calls: list[Callable[[], object]]) -> list[float]:
    durations = []
    for call in calls:
        begun = time.perf_counter()
        call()
        durations.append(1e3 * (time.perf_counter() - begun))
    return durations


def _median(durations: list[float]) -> float:
    return float(np.median(durations))


def _ticks(arm: Kinematics, planner: Planner, limits: JointLimits) -> list[float]:
    """Time the control periods of a motion, in simulated time."""
    now = [0.0]
    supervisor = Supervisor(arm, planner, limits, period=_PERIOD, clock=lambda: now[0])
    middle = 0.5 * (np.maximum(limits.lower, -2.0) + np.minimum(limits.upper, 2.0))
    q = middle + np.linspace(0.4, 0.7, limits.size)
    durations: list[float] = []
    target = arm.forward(q) @ transforms.make(np.eye(3), (0.02, 0.02, -0.05))
    for k in range(1500):
        now[0] += _PERIOD
        supervisor.joint_state(now[0], q)
        if k % 300 == 30:
            goal = target if k % 600 == 30 else arm.forward(middle + np.linspace(0.4, 0.7, limits.size))
            _quietly(partial(supervisor.begin, Kind.POSE, goal, duration=2.0))
        begun = time.perf_counter()
        state = supervisor.tick()
        if state is not None:
            durations.append(1e3 * (time.perf_counter() - begun))
            q = state.position
    return durations or [float("nan")]


def _replans(limits: JointLimits, joints: list[Array]) -> list[float]:
    stream = SetpointStream(limits, _PERIOD)
    stream.start(joints[0])
    durations = []
    for goal in joints[1:]:
        begun = time.perf_counter()
        _quietly(partial(stream.move, goal, duration=2.0))
        durations.append(1e3 * (time.perf_counter() - begun))
        for _ in range(40):
            stream.advance()
    return durations


def _cloud() -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """A gently curved surface with the dots of a whole pattern."""
    row, col = (a.ravel() for a in np.mgrid[0:44, 0:58])
    x, y = 0.006 * (col - 28.5), 0.006 * (row - 21.5)
    noise = np.random.default_rng(1).normal(scale=3e-4, size=row.size)
    return np.stack([x, y, 0.5 + 0.3 * (x**2 + y**2) + noise], axis=1), row, col
