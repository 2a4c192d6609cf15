"""The state machine over one arm: starts, watches and ends motions, always by a stop within the limits."""

import threading
import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from arm_positioner import watchdog
from arm_positioner.errors import Code, InvalidGoalError, PositionerError
from arm_positioner.limits import JointLimits
from arm_positioner.measured_arm import MeasuredArm
from arm_positioner.motion import Motion
from arm_positioner.permission import Permission
from arm_positioner.planning import Planner
from arm_positioner.task import Kind, Outcome, Task
from arm_positioner.trajectory import MotionState, Trajectory
from arm_positioner.watchdog import WatchOptions
from sl_common.kinematics import Kinematics

Array = NDArray[np.float64]


class Supervisor:
    """Runs one task at a time and brings the arm to rest whenever something is wrong.

    All methods may be called from any thread. Times are of one monotonic clock [s]; stamps are converted to it.

    Attributes:
        arm: The arm as measured, with the hand-eye transform.
        code: Status code.
        message: One sentence with the numbers.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        planner: Planner,
        limits: JointLimits,
        *,
        period: float,
        options: WatchOptions | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Use ``kinematics`` and ``planner`` (with another kinematics) exclusively; a setpoint every ``period`` [s]."""
        self.options = options or WatchOptions()
        self.code, self.message = Code.IDLE, "at rest, no target yet"
        self.arm = MeasuredArm(kinematics, rest_motion=self.options.rest_motion)
        self._planner = planner
        self._motion = Motion(self.arm, limits, period, self.options)
        self._stream = self._motion.stream
        self._permission = Permission()
        self._clock = clock
        self._lock = threading.RLock()
        self._planning_lock = threading.Lock()
        self._task: Task | None = None
        self._ending: Outcome | None = None

    @property
    def flange_from_camera(self) -> Array:
        """The hand-eye transform (4, 4) [m]."""
        return self.arm.flange_from_camera

    @flange_from_camera.setter
    def flange_from_camera(self, transform: Array) -> None:
        self.arm.flange_from_camera = transform

    def positions_from(self, names: Sequence[str], positions: Sequence[float]) -> Array:
        """Return the arm's positions (n,) out of a joint state; see :meth:`Kinematics.positions_from`."""
        return self.arm.positions_from(names, positions)

    def joint_state(self, time: float, positions: Array) -> None:
        """Take joint positions (n,) measured at ``time`` [s]."""
        with self._lock:
            self.arm.joints.add(time, positions)

    def order(self) -> int:
        """Return the number of a new order: orders before it that wait for something do not begin any more."""
        with self._lock:
            return self._permission.order()

    def begin(
        self,
        kind: Kind,
        target: Array,
        *,
        duration: float = 0.0,
        follow: bool = False,
        free_roll: bool = False,
        order: int | None = None,
    ) -> Task:
        """Start moving the camera to ``target`` (4, 4 base_from_camera), replacing the task that runs.

        Args:
            kind: Where the target comes from.
            target: Wanted camera pose [m].
            duration: Least duration of the motion [s].
            follow: Keep the task until it is cancelled; :meth:`retarget` moves its target.
            free_roll: The camera may be turned about its optical axis to keep clear of singularities; the task's target
                says by how much it is.
            order: From :meth:`order`; None: a new one.

        Raises PositionerError, and nothing changes: no joint states, arm not at rest, paused, unreachable, a newer
        order or a stop since ``order`` was given, and so on.
        """
        if not (np.isfinite(duration) and duration >= 0):
            raise InvalidGoalError(f"duration {duration:g} s must be zero or positive")
        order = self.order() if order is None else order
        with self._planning_lock:
            with self._lock:
                self._permission.require(order)
                current = self._motion.begin(self._clock())
            plan = self._planner.choose(
                target, self.flange_from_camera, current, lambda q: self._preview(q, duration), free_roll=free_roll
            )
            with self._lock:
                self._permission.require(order)
                motion = self._motion.move(plan.positions, duration=duration)
                if self._task is not None:
                    self._task.finish(Outcome(Code.STOPPED, "replaced by a new target"))
                self._task = Task(kind, plan.base_from_camera, plan.positions, follow=follow, time=self._clock())
                if kind is not Kind.SERVO:
                    self._task.arrive_at = self._clock() + motion.duration
                self._ending = None
                self._report_moving(self._task)
                return self._task

    def retarget(self, task: Task, target: Array) -> None:
        """Move the target of a running task; where that fails the arm holds still until a target succeeds.

        Does nothing for a task that has ended or is being ended.
        """
        with self._planning_lock:
            with self._lock:
                if not self._is_running(task):
                    return
                task.target_time = self._clock()
                goal = task.goal
                if task.held is not None and not self._stream.is_moving:
                    try:
                        self._motion.begin(self._clock())
                    except PositionerError as error:
                        self._end(Outcome(error.code, str(error)))
                        return
            try:
                positions = self._planner.follow(target, self.flange_from_camera, goal).positions
                with self._lock:
                    if not self._is_running(task):
                        return
                    self._motion.steer(positions, duration=max(task.arrive_at - self._clock(), 0.0))
                    task.goal, task.target, task.rest_since, task.held = positions, target, None, None
                    self._report_moving(task)
            except PositionerError as error:
                with self._lock:
                    if self._is_running(task):
                        self._hold(task, Outcome(error.code, str(error)))

    def confirm(self, task: Task) -> None:
        """Note that the cloud still shows the object of a task whose target stays."""
        with self._lock:
            task.target_time = self._clock()
            if self._is_running(task) and task.held is not None and task.held.code is Code.LOST_CLOUD:
                self._resume(task)

    def cancel(self, task: Task, outcome: Outcome) -> None:
        """End a task early: the arm comes to rest, then the task has its outcome."""
        with self._lock:
            if task is self._task:
                self._end(outcome)

    def pause(self, *, paused: bool) -> str:
        """Bring the arm to rest and keep the task, or go on with it; returns what happens.

        Raises PositionerError where the motion cannot go on; the task is then ended.
        """
        with self._lock:
            if not paused and not self._permission.paused:
                return "not paused"
            self._permission.paused = paused
            if self._ending is not None:  # it is being brought to rest already, and its task is over
                return f"{'paused' if paused else 'resumed'}; {self.message}"
            if paused:
                self._interrupt()
                self._report(Code.PAUSED, self._rest_message("paused by ~/pause"))
            elif self._task is None:
                self._report(Code.IDLE, "at rest, no target")
                return "resumed, no target"
            else:
                self._resume(self._task)
            return self.message

    def stop(self, reason: str = "stopped by ~/stop") -> str:
        """Bring the arm to rest and end the task, and whatever waits to become one; returns what happens.

        A pause stays in force.
        """
        with self._lock:
            self._permission.void()
            self._end(Outcome(Code.STOPPED, reason))
            return self.message

    def close(self, reason: str = "stopped: the node shuts down") -> None:
        """Stop and take no task any more."""
        with self._lock:
            self._permission.closed = True
            self.stop(reason)

    def fail(self, reason: str) -> None:
        """End everything at once: no setpoint will leave any more."""
        with self._lock:
            self._permission.closed = True
            self._finish(Outcome(Code.INVALID_INPUT, reason))

    def tick(self) -> MotionState | None:
        """Advance by one control period and return the setpoint to send; None at rest."""
        now = self._clock()
        with self._lock:
            if self._task is not None and self._is_running(self._task):
                try:
                    self._check(self._task, now)
                except Exception as error:  # a defect in what watches must not break off the stream in mid-motion
                    self._end(Outcome(Code.INVALID_INPUT, f"the watch failed: {error!r}"))
            setpoint = self._motion.advance(now)
            if self._stream.fault and self._ending is None and self._task is not None:
                self._end(Outcome(Code.INVALID_INPUT, f"setpoint held back: {self._stream.fault}"))
            if not self._stream.is_moving:
                self._at_rest(now)
            return setpoint

    def outlook(self, horizon: float) -> list[MotionState]:
        """Return the setpoints to come, a stop behind ``horizon`` [s]; see :meth:`SetpointStream.outlook`."""
        with self._lock:
            return self._stream.outlook(horizon)

    @property
    def motion_id(self) -> int:
        """Changes whenever the trajectory does."""
        return self._stream.motion_id

    @property
    def task(self) -> Task | None:
        """The running task."""
        return self._task

    @property
    def is_moving(self) -> bool:
        """Whether setpoints are leaving."""
        return self._stream.is_moving

    @property
    def remaining(self) -> float:
        """Time until rest [s]."""
        return self._stream.remaining

    def camera_pose(self) -> Array | None:
        """Return base_from_camera (4, 4) by the newest joint state [m]; None: none yet."""
        with self._lock:
            return self.arm.camera_pose()

    def condition(self) -> float:
        """Return the condition number at the newest joint state; NaN: none yet."""
        with self._lock:
            return self.arm.condition()

    def error(self, task: Task) -> tuple[float, float]:
        """Return the distance [m] and angle [rad] from the measured camera pose to a task's target; NaN: not known."""
        with self._lock:
            return self.arm.error(task.target)

    def _is_running(self, task: Task) -> bool:
        return task is self._task and self._ending is None and not self._permission.paused

    def _check(self, task: Task, now: float) -> None:
        """Compare everything that is watched with its limits; end or hold the task."""
        options = self.options
        problem = watchdog.stale_joints(now - self.arm.joints.newest_time, options) or self._motion.deviation()
        if problem is None and self._stream.is_moving:
            problem = watchdog.stale_target(task, now, options)
        if problem := problem or watchdog.waited_too_long(task, now, options):
            self._end(problem)
        elif (problem := watchdog.lost_cloud(task, now, options)) and task.held is None:
            self._hold(task, problem)
        elif self._stream.is_moving and task.held is None:
            self._check_singularity(task)

    def _check_singularity(self, task: Task) -> None:
        condition, allowed = self._motion.look_ahead()
        if not allowed:
            outcome = watchdog.singular(condition, self.options)
            if task.tracks:
                self._hold(task, outcome)
                self._motion.pace.forget()
            else:
                self._end(outcome)
            return
        try:
            if not self._motion.change_pace(task.goal, condition):
                return
        except PositionerError:
            return  # the present motion goes on; it is within all limits too
        if (speed := self._motion.pace.speed) < 1.0:
            reason = f"slowed down to {100 * speed:.0f} %: condition number {condition:.0f}"
            self._report(Code.SINGULARITY, f"{reason}, stop at {self.options.thresholds.stop:.0f}")
        else:
            self._report_moving(task)

    def _at_rest(self, now: float) -> None:
        """Draw the conclusions once no setpoint is left to send."""
        if self._ending is not None:
            ending, self._ending = self._ending, None
            self._finish(Outcome(ending.code, f"{ending.message}; at rest"))
        elif self._permission.paused:
            self._report(Code.PAUSED, "paused by ~/pause; at rest")
        elif self._task is not None and self._task.held is None:
            self._arrive(self._task, now)

    def _arrive(self, task: Task, now: float) -> None:
        """Compare the measured pose with the target after the last setpoint."""
        if task.rest_since is None:
            task.rest_since = now
        arrival = watchdog.arrival(task, self.arm.error(task.target), now, self.options, self._motion.has_settled)
        if arrival is None:
            return
        outcome, over = arrival
        if over:
            self._finish(outcome)
        else:
            self._report(outcome.code, outcome.message)

    def _finish(self, outcome: Outcome) -> None:
        self._report(outcome.code, outcome.message)
        task, self._task = self._task, None
        if task is not None:
            task.finish(outcome)

    def _end(self, outcome: Outcome) -> None:
        """Brake; the task gets its outcome when the arm is at rest."""
        if self._ending is not None:
            return
        self._stream.stop()
        self._ending = outcome
        self._report(outcome.code, self._rest_message(outcome.message))

    def _hold(self, task: Task, outcome: Outcome) -> None:
        """Brake and keep the task."""
        if task.held is None:
            task.held_since = self._clock()
        task.held, task.rest_since = outcome, None
        self._interrupt()
        reason = self._rest_message(outcome.message)
        self._report(outcome.code, f"{reason}; waiting up to {self.options.lost_timeout:g} s")

    def _interrupt(self) -> None:
        """Brake, to go on later."""
        if self._task is not None and self._stream.is_moving:
            self._task.remaining = max(self._task.arrive_at - self._clock(), 0.0)
        self._stream.stop()

    def _resume(self, task: Task) -> None:
        """Go on to the goal of a task that was paused or held."""
        now = self._clock()
        try:
            task.arrive_at = now + self._motion.resume(task.goal, duration=task.remaining, now=now).duration
        except PositionerError as error:
            self._end(Outcome(error.code, f"cannot go on: {error}"))
            return
        task.held, task.rest_since = None, None
        self._report_moving(task)

    def _preview(self, positions: Array, duration: float) -> Trajectory:
        with self._lock:
            return self._stream.preview(positions, duration=duration)

    def _report_moving(self, task: Task) -> None:
        if self._motion.pace.speed == 1.0:
            doing, code = ("following", Code.FOLLOWING) if task.follow else ("moving to", Code.MOVING)
            self._report(code, f"{doing} the target, at rest in {self._stream.remaining:.2f} s")

    def _rest_message(self, reason: str) -> str:
        if self._stream.is_moving:
            return f"{reason}; at rest in {self._stream.remaining:.2f} s"
        return f"{reason}; at rest"

    def _report(self, code: Code, message: str) -> None:
        self.code, self.message = code, message
