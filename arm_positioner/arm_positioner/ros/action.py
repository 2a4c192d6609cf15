"""The action ~/position_arm on top of the supervisor."""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from arm_positioner.choosing import camera_sigma, first_possible, tells_more
from arm_positioner.errors import (
    Code,
    InvalidGoalError,
    NotAtRestError,
    PositionerError,
    StaleJointsError,
    SupersededError,
)
from arm_positioner.ros.conversions import stamped
from arm_positioner.ros.parameters import Settings
from arm_positioner.ros.scene import Scene
from arm_positioner.sight import nearly_equal
from arm_positioner.supervisor import Supervisor
from arm_positioner.surface import SurfacePatch
from arm_positioner.target import Target, TargetOptions
from arm_positioner.task import Kind, Outcome, Task
from sl_common.errors import StructuredLightError
from sl_msgs.action import PositionArm

Array = NDArray[np.float64]

_FEEDBACK_PERIOD = 0.1
_SUCCESS = (Code.REACHED,)


class PositionArmServer:
    """Runs the goals of ~/position_arm; a new goal replaces the running one without a halt."""

    def __init__(self, node: Node, settings: Settings, scene: Scene, supervisor: Callable[[], Supervisor]) -> None:
        """Serve the action; ``supervisor`` returns it or raises PositionerError while there is no arm yet."""
        self._node, self._settings, self._scene, self._supervisor = node, settings, scene, supervisor
        self._server = ActionServer(
            node,
            PositionArm,
            "~/position_arm",
            execute_callback=self._execute,
            goal_callback=lambda _request: GoalResponse.ACCEPT,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    def _execute(self, goal: ServerGoalHandle) -> PositionArm.Result:
        begun = time.monotonic()
        result = PositionArm.Result(position_error=float("nan"), orientation_error=float("nan"))
        try:
            supervisor = self._supervisor()
            outcome, task = self._run(supervisor, goal, supervisor.order())
            if task is not None:
                result.position_error, result.orientation_error = supervisor.error(task)
                now = self._node.get_clock().now().nanoseconds
                result.target = stamped(task.target, self._settings.base_frame, now)
        except PositionerError as error:
            outcome = Outcome(error.code, str(error))
            self._node.get_logger().warning(f"goal refused: {error}")
        except StructuredLightError as error:
            outcome = Outcome(Code.INVALID_INPUT, str(error))
            self._node.get_logger().warning(f"goal refused: {error}")
        result.success = outcome.code in _SUCCESS
        result.code, result.message = int(outcome.code), outcome.message
        result.duration = time.monotonic() - begun
        if result.success:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return result

    def _run(self, supervisor: Supervisor, goal: ServerGoalHandle, order: int) -> tuple[Outcome, Task | None]:
        request = goal.request
        if request.use_goal_pose:
            self._scene.reset()
            target = self._scene.base_from_goal(request.goal_pose)
            task = self._begin(supervisor, goal, order, Kind.POSE, target)
            return self._await(supervisor, goal, task), task
        options = self._options(request.standoff)
        self._scene.choose_anew()

        def begin(wanted: Target) -> Task:
            pose, free = wanted.base_from_camera, self._settings.free_roll
            return self._begin(supervisor, goal, order, Kind.OBJECT, pose, follow=request.follow, free_roll=free)

        preferred = self._scene.look(options, self._settings.goal_timeout)
        seen, task, choice = first_possible(preferred, lambda: self._scene.others(options), begin)
        if choice:
            self._scene.take(seen)
            self._node.get_logger().info(f"going to a place {choice}")
        with self._scene.tracking(task, options):
            outcome = self._await(supervisor, goal, task)
        for _ in range(self._settings.refinements):
            if outcome.code is not Code.REACHED or goal.is_cancel_requested:
                break
            try:
                better = self._look_again(seen, options)
                if better is None:
                    break
                seen = better
                if nearly_equal(seen.base_from_camera, task.target):
                    break
                task = self._begin(supervisor, goal, order, Kind.OBJECT, seen.base_from_camera, duration=1.0)
            except PositionerError as error:
                self._node.get_logger().info(f"target kept, no second look: {error}")
                break
            with self._scene.tracking(task, options):
                outcome = self._await(supervisor, goal, task)
        return self._with_certainty(outcome, seen.surface, choice), task

    def _look_again(self, seen: Target, options: TargetOptions) -> Target | None:
        """Return the target as it is seen from in front of it; None where that tells no more than the look before."""
        better = self._scene.look(options, self._settings.watch.cloud_timeout, anchor=seen.surface.point)
        if tells_more(seen, better):
            return better
        before, now = (1e3 * camera_sigma(target) for target in (seen, better))
        self._node.get_logger().info(f"target kept: known to {before:.1f} mm, by a second look to {now:.1f} mm only")
        return None

    def _with_certainty(self, outcome: Outcome, surface: SurfacePatch, choice: str) -> Outcome:
        """Say which place was chosen where it is not the one preferred, and how well its normal was known; warn where
        that is not enough.
        """
        if outcome.code is not Code.REACHED:
            return outcome
        sigma, limit = surface.normal_sigma, self._settings.doubtful_normal_sigma
        text = f"surface normal known to {np.degrees(sigma):.2f} deg"
        if sigma > limit:
            text += f", more than {np.degrees(limit):.2f} deg: it bends or is seen by too few dots there"
            self._node.get_logger().warning(text)
        return Outcome(outcome.code, "; ".join(filter(None, (outcome.message, choice, text))))

    def _options(self, standoff: float) -> TargetOptions:
        if not np.isfinite(standoff) or standoff < 0:
            raise InvalidGoalError(f"standoff {standoff:g} m must be positive, or 0 for the parameter's")
        options = self._settings.target
        return replace(options, standoff=standoff) if standoff > 0 else options

    def _begin(
        self,
        supervisor: Supervisor,
        goal: ServerGoalHandle,
        order: int,
        kind: Kind,
        target: Array,
        *,
        follow: bool = False,
        free_roll: bool = False,
        duration: float | None = None,
    ) -> Task:
        """Begin a motion, waiting a while for joint states and for an arm that still moves by itself."""
        asked = (goal.request.duration or self._settings.duration) if duration is None else duration
        deadline = time.monotonic() + self._settings.goal_timeout
        while True:
            if goal.is_cancel_requested:
                raise SupersededError("goal cancelled before it began")
            try:
                return supervisor.begin(kind, target, duration=asked, follow=follow, free_roll=free_roll, order=order)
            except (NotAtRestError, StaleJointsError):
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.02)

    def _await(self, supervisor: Supervisor, goal: ServerGoalHandle, task: Task) -> Outcome:
        feedback = PositionArm.Feedback()
        while not task.wait(_FEEDBACK_PERIOD):
            if goal.is_cancel_requested:
                supervisor.cancel(task, Outcome(Code.STOPPED, "goal cancelled"))
            feedback.code = int(supervisor.code)
            feedback.distance, feedback.angle = supervisor.error(task)
            feedback.time_remaining = supervisor.remaining
            feedback.condition_number = supervisor.condition()
            goal.publish_feedback(feedback)
        assert task.outcome is not None
        return task.outcome
