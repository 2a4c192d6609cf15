"""What the node knows of the scene: clouds, camera poses at their stamps, the hand-eye calibration."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from geometry_msgs.msg import PoseStamped
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from arm_positioner.errors import InvalidGoalError, PositionerError, TargetError
from arm_positioner.following import TargetFilter
from arm_positioner.hand_eye import HandEye
from arm_positioner.ros.complaints import Complaints
from arm_positioner.ros.conversions import pose_to_array, sighting
from arm_positioner.ros.parameters import Settings
from arm_positioner.sight import Sight, Sighting, nearly_equal
from arm_positioner.supervisor import Supervisor
from arm_positioner.target import Target, TargetOptions
from arm_positioner.target_process import TargetProcess
from arm_positioner.task import Task
from sl_common.errors import InvalidInputError, StructuredLightError
from sl_common.joint_buffer import JointBuffer, JointLookupError, TooLate
from sl_common.kinematics import Kinematics
from sl_common.ros.stamps import to_ns

Array = NDArray[np.float64]

_PAIRING_WAIT = 0.1
"""How long a cloud or goal waits for the joint state behind its stamp [s]."""


_CLOCK_SET = 0.5
"""Joint states this much older than the newest are no late messages: the clock was set back [s]."""
_RESPONSE = 0.2
"""How far ahead a followed target is aimed at [s]: about the time the arm takes to get there."""


class Scene:
    """Turns clouds and goals into camera poses in the base frame, each with the arm as it stood at its stamp."""

    def __init__(self, node: Node, settings: Settings, hand_eye: HandEye, complaints: Complaints) -> None:
        """Start without an arm; :meth:`attach` gives it one."""
        self._node, self._settings, self._hand_eye, self._complaints = node, settings, hand_eye, complaints
        self._fitting = TargetProcess()
        smoothing = TargetFilter(time_constant=max(settings.follow_smoothing, 1e-3))
        self._sight = Sight(smoothing, self._fitting.find, self._fitting.others)
        self._joints = JointBuffer(max_gap=settings.watch.joint_timeout)
        self._joint_lock = threading.Lock()
        self._fresh = threading.Condition()
        self._cloud: PointCloud2 | None = None
        self._kinematics: Kinematics | None = None
        self._supervisor: Supervisor | None = None
        self._tracked: tuple[Task, TargetOptions] | None = None

    def attach(self, kinematics: Kinematics, supervisor: Supervisor) -> None:
        """Use an arm; ``kinematics`` is not shared with another thread."""
        self._kinematics, self._supervisor = kinematics, supervisor

    def close(self) -> None:
        """End the process that fits surfaces."""
        self._fitting.close()

    @property
    def seen(self) -> Target | None:
        """The target in the last cloud looked at."""
        return self._sight.latest

    def reset(self) -> None:
        """Forget the object: the next goal takes the nearest one."""
        self._sight.reset()

    def choose_anew(self) -> None:
        """Keep the object but choose the place on it anew."""
        self._sight.choose_anew()

    def add_joints(self, stamp_ns: int, positions: Array) -> None:
        """Keep joint positions for pairing by stamp.

        Where the clock was set back, as by a bag played again, those from before the jump are forgotten: clouds must
        not be paired with the motion of another time.
        """
        with self._joint_lock:
            newest = self._joints.newest
            if newest is not None and stamp_ns < newest[0] - round(
                1e9 * max(_CLOCK_SET, self._settings.watch.joint_timeout)
            ):
                self._joints.clear()
            self._joints.add(stamp_ns, positions)

    def add_cloud(self, message: PointCloud2) -> None:
        """Take a cloud: those who wait get it, and a tracked task is told where its object is now."""
        with self._fresh:
            self._cloud = message
            self._fresh.notify_all()
        tracked = self._tracked
        if tracked is None or self._supervisor is None:
            return
        task, options = tracked
        try:
            target = self._target(message, options, None)
        except StructuredLightError as error:
            self._complaints.warn(f"point cloud not used: {error}")
            return
        pose = self._sight.expected(time.monotonic() + _RESPONSE) if task.follow else task.target
        if task.follow and not nearly_equal(pose, task.target):
            self._supervisor.retarget(task, pose)
        else:
            self._supervisor.confirm(task)
        self._node.get_logger().debug(f"object with {target.object_points} points")

    @contextmanager
    def tracking(self, task: Task, options: TargetOptions) -> Iterator[None]:
        """While this lasts, every cloud confirms or moves the task's target."""
        mine = (task, options)
        self._tracked = mine
        try:
            yield
        finally:
            if self._tracked is mine:
                self._tracked = None

    def look(self, options: TargetOptions, timeout: float, *, anchor: Array | None = None) -> Target:
        """Return the target in a present cloud, the first within ``timeout`` [s] that shows one.

        Args:
            options: Of the target.
            timeout: How long to try [s].
            anchor: (3,) surface point to stay at [m]; only clouds taken from now on count then.

        Raises InvalidGoalError without a hand-eye calibration, TargetError with the reason of the last cloud otherwise.
        """
        if self._hand_eye.problem:
            raise InvalidGoalError(
                f"positioning in front of an object needs the camera's pose; {self._hand_eye.problem}"
            )
        begun, deadline = self._now(), time.monotonic() + timeout
        oldest = begun - round(1e9 * (0.0 if anchor is not None else self._settings.watch.cloud_timeout))
        topic = self._node.resolve_topic_name("points")
        failure: PositionerError = TargetError(f"no point cloud on {topic} within {timeout:g} s")
        tried: PointCloud2 | None = None
        while True:
            with self._fresh:
                while (message := self._cloud) is tried and self._fresh.wait(max(deadline - time.monotonic(), 0.0)):
                    pass
            if message is None or message is tried:
                raise failure
            tried = message
            if to_ns(message.header.stamp) < oldest:
                age = 1e-9 * (self._now() - to_ns(message.header.stamp))
                failure = TargetError(f"the newest point cloud on {topic} is {age:.2f} s old")
                continue
            try:
                return self._target(message, options, anchor)
            except PositionerError as error:
                failure = error
            except StructuredLightError as error:
                failure = InvalidGoalError(str(error))

    def others(self, options: TargetOptions) -> list[Target]:
        """Return targets before other places of the object in the newest cloud; see :meth:`.Sight.others`.

        Raises TargetError or another StructuredLightError where that cloud is of no use any more.
        """
        message = self._cloud
        if message is None:
            raise TargetError("no point cloud any more")
        return self._sight.others(self._sighting(message), options)

    def take(self, target: Target) -> None:
        """Keep to the place of ``target`` from now on."""
        self._sight.take(target)

    def base_from_goal(self, message: PoseStamped) -> Array:
        """Return base_from_camera (4, 4) of a goal in the base or the camera frame.

        Raises InvalidGoalError for another frame or numbers that are no pose, JointLookupError where the camera's
        pose at the goal's stamp is not known.
        """
        pose = pose_to_array(message.pose)
        frame = message.header.frame_id
        if frame in ("", self._settings.base_frame):
            return pose
        if frame != self._settings.camera_frame:
            raise InvalidGoalError(
                f"pose in frame '{frame}', expected '{self._settings.base_frame}' or '{self._settings.camera_frame}'"
            )
        stamp = to_ns(message.header.stamp)
        return self._camera_at(stamp or self._newest_stamp()) @ pose

    def _target(self, message: PointCloud2, options: TargetOptions, anchor: Array | None) -> Target:
        return self._sight.look(self._sighting(message), options, anchor=anchor)

    def _sighting(self, message: PointCloud2) -> Sighting:
        """Return a cloud in the base frame; raises StructuredLightError for one that is too old or of no use."""
        stamp, frame = to_ns(message.header.stamp), message.header.frame_id
        age = 1e-9 * (self._now() - stamp)
        if age > self._settings.watch.cloud_timeout:
            raise TargetError(f"the point cloud is {age:.2f} s old, limit {self._settings.watch.cloud_timeout:g} s")
        if frame not in (self._settings.base_frame, self._settings.camera_frame):
            raise InvalidInputError(
                f"point cloud in frame '{frame}', expected '{self._settings.base_frame}' or "
                f"'{self._settings.camera_frame}'"
            )
        camera = self._camera_at(stamp)
        return sighting(
            message,
            time.monotonic() - age,
            camera,
            self._hand_eye.projector,
            in_camera_frame=frame == self._settings.camera_frame,
        )

    def _camera_at(self, stamp_ns: int) -> Array:
        deadline = time.monotonic() + _PAIRING_WAIT
        while True:
            try:
                with self._joint_lock:
                    if self._kinematics is None:
                        raise InvalidGoalError("no robot_description yet")
                    return self._kinematics.forward(self._joints.at(stamp_ns)) @ self._hand_eye.flange_from_camera
            except TooLate:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.005)

    def _newest_stamp(self) -> int:
        with self._joint_lock:
            newest = self._joints.newest
        if newest is None:
            raise JointLookupError("no joint state received yet")
        return newest[0]

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)
