"""An arm and its supervisor in simulated time, without ROS."""

import numpy as np
from positioner_checks import limit_violations
from positioner_robots import HOME, kinematics

from arm_positioner.limits import from_urdf
from arm_positioner.planning import Planner
from arm_positioner.singularity import SingularityThresholds
from arm_positioner.supervisor import Supervisor
from arm_positioner.task import Kind
from arm_positioner.watchdog import WatchOptions
from sl_common import transforms

PERIOD = 0.008


class Simulation:
    """Ticks a supervisor and lets an ideal driver with a lag follow the setpoints.

    Attributes:
        setpoints: What has left, the measured start first.
        q: The joints as they are.
        silent: No joint states reach the supervisor.
        blocked: The driver does not move.
        offset: Error of the driver at rest.
    """

    def __init__(self, robot="six", lag=3, home=None, acceleration=2.5, jerk=25.0, **options):
        self.arm = kinematics(robot)
        self.limits = from_urdf(
            self.arm.joint_names,
            self.arm.lower,
            self.arm.upper,
            self.arm.max_velocity,
            velocity_scale=0.5,
            max_acceleration=[acceleration],
            max_jerk=[jerk],
        )
        thresholds = options.pop("thresholds", SingularityThresholds())
        self.time = 100.0
        self.supervisor = Supervisor(
            self.arm,
            Planner(kinematics(robot), self.limits, thresholds=thresholds),
            self.limits,
            period=PERIOD,
            options=WatchOptions(thresholds=thresholds, **options),
            clock=lambda: self.time,
        )
        self.q = (HOME[robot] if home is None else np.asarray(home)).copy()
        self._pipe = [self.q.copy()] * lag
        self.setpoints = [self.q.copy()]
        self.codes = [self.supervisor.code]
        self.silent = self.blocked = False
        self.offset = np.zeros_like(self.q)
        self.run(0.3)

    def step(self):
        self.time += PERIOD
        if not self.silent:
            self.supervisor.joint_state(self.time, self.q + self.offset)
        state = self.supervisor.tick()
        if state is not None:
            self.setpoints.append(state.position.copy())
        self._pipe.append(self.setpoints[-1])
        goal = self._pipe.pop(0)
        if not self.blocked:
            self.q = goal
        if self.supervisor.code != self.codes[-1]:
            self.codes.append(self.supervisor.code)

    def run(self, seconds):
        for _ in range(round(seconds / PERIOD)):
            self.step()

    def finish(self, task, timeout=30.0):
        """Run until a task has its outcome."""
        end = self.time + timeout
        while task.outcome is None and self.time < end:
            self.step()
        assert task.outcome is not None, (self.supervisor.code, self.supervisor.message)
        return task.outcome

    def camera(self, q=None):
        return self.arm.forward(self.q if q is None else q)


def shifted(sim, x=0.0, y=0.0, z=0.0, rotation=(0.0, 0.0, 0.0)):
    return sim.camera() @ transforms.make(transforms.rotation_exp(rotation), (x, y, z))


def moving(sim, kind=Kind.POSE, **kwargs):
    task = sim.supervisor.begin(kind, shifted(sim, x=0.2, rotation=(0.2, 0.1, 0.0)), duration=2.0, **kwargs)
    sim.run(0.6)
    assert sim.supervisor.is_moving
    return task


def assert_clean(sim):
    assert limit_violations(np.array(sim.setpoints), sim.limits, PERIOD) == []
    assert not sim.supervisor.is_moving
