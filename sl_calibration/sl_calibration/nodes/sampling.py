"""Taking samples: the next usable shots, with the flange pose at their stamp where the procedure needs it."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import Image

from sl_calibration.nodes.awaiting import within
from sl_calibration.nodes.background import Background
from sl_calibration.nodes.messages import dots_from_message
from sl_calibration.nodes.projection import Projection
from sl_calibration.nodes.robot import Pairing, Robot
from sl_calibration.procedures.procedure import Procedure, Setup, Shot, ShotDots, Source
from sl_calibration.sessions import Sample
from sl_common.errors import InvalidInputError, StructuredLightError
from sl_common.joint_buffer import JointLookupError
from sl_common.ros import images
from sl_common.ros.qos import STREAM_SUBSCRIBE
from sl_common.ros.stamps import to_ns
from sl_common.ros.waiting import InputWatch
from sl_msgs.msg import Correspondences

Array = NDArray[np.float64]

_SPEED_SPAN = 40_000_000  # [ns] over which the joint speed before an image is measured
_NOTHING = {
    Source.DOTS: "no correspondences received: is the decoder running and the pattern shown?",
    Source.IMAGES: "no images received on camera/image_raw: is the camera running?",
}
_TOPIC: dict[Source, tuple[str, Any]] = {
    Source.DOTS: ("correspondences", Correspondences),
    Source.IMAGES: ("camera/image_raw", Image),
}


class Shots:
    """Subscribes what a procedure is made of and hands out the next shot after a moment."""

    def __init__(
        self,
        node: Node,
        watch: InputWatch,
        source: Source,
        robot: Robot | None,
        *,
        max_joint_speed: float,
        wait: float,
        seen: Callable[[str], None],
    ) -> None:
        """``max_joint_speed`` [rad/s] of a robot at rest: latency and exposure must not count; ``wait`` [s] for the
        joint state after an image; ``seen`` is told the topic of every message."""
        self._node, self._watch, self._source, self._seen = node, watch, source, seen
        self._robot, self._max_joint_speed = robot, max_joint_speed
        self._pairing: Pairing[Any] | None = None
        if robot is not None:
            self._pairing = Pairing(
                node, robot, wait=wait, deliver=self._deliver, refuse=lambda _, reason: self._refuse(reason)
            )
        self._waiting: Future | None = None
        self._after = 0
        self._reason = ""
        self._topic, kind = _TOPIC[source]
        watch.expect(self._topic, kind, STREAM_SUBSCRIBE)
        node.create_subscription(kind, self._topic, self._on_message, STREAM_SUBSCRIBE)

    async def next(self, timeout: float, after: int) -> Shot:
        """Return the next shot with a stamp of ``after`` [ns] or later.

        Raises InvalidInputError with the reason of the last refusal when none comes within ``timeout`` [s], or when
        another sample is being taken.
        """
        if self._waiting is not None:
            raise InvalidInputError("another sample is being taken")
        self._waiting = waiting = Future()
        self._after, self._reason = after, _NOTHING[self._source]
        try:
            if not await within(self._node, waiting, timeout):
                raise InvalidInputError(f"no usable view within {timeout:g} s: {self._reason}")
        finally:
            self._waiting = None
        shot = waiting.result()
        assert isinstance(shot, Shot)
        return shot

    def _on_message(self, message: Any) -> None:
        self._watch.seen(self._topic)
        self._seen(self._topic)
        stamp = to_ns(message.header.stamp)
        if self._waiting is None or self._waiting.done() or stamp < self._after:
            return
        if self._pairing is None:
            self._take(message, None, None)
        else:
            self._pairing.add(stamp, message)

    def _refuse(self, reason: str) -> None:
        self._reason = reason

    def _deliver(self, message: Any, base_from_flange: Array) -> None:
        try:
            joints = self._at_rest(to_ns(message.header.stamp))
        except StructuredLightError as error:
            self._refuse(str(error))
            return
        self._take(message, base_from_flange, joints)

    def _take(self, message: Any, base_from_flange: Array | None, joints: Array | None) -> None:
        if self._waiting is None or self._waiting.done():
            return
        try:
            shot = _shot(message, base_from_flange, joints)
        except StructuredLightError as error:
            self._refuse(str(error))
            return
        self._waiting.set_result(shot)

    def _at_rest(self, stamp: int) -> Array:
        """Return the joint positions; raises InvalidInputError for a robot that moves."""
        assert self._robot is not None
        joints = self._robot.positions_at(stamp)
        try:
            before = self._robot.positions_at(stamp - _SPEED_SPAN)
        except JointLookupError as error:
            raise InvalidInputError(f"whether the robot rests is not known: {error}") from None
        speed = float(np.abs(joints - before).max()) / (1e-9 * _SPEED_SPAN)
        if speed > self._max_joint_speed:
            raise InvalidInputError(
                f"the robot moves at {speed:.3f} rad/s, limit {self._max_joint_speed:g}: bring it to rest"
            )
        return joints


def _shot(message: Any, base_from_flange: Array | None, joints: Array | None) -> Shot:
    stamp = to_ns(message.header.stamp)
    if isinstance(message, Image):
        return Shot(stamp, images=(images.to_bgr(message),), base_from_flange=base_from_flange, joints=joints)
    found = dots_from_message(message)
    dots = ShotDots(message.pattern_id, found.row, found.col, found.camera, found.confidence)
    return Shot(stamp, dots=dots, base_from_flange=base_from_flange, joints=joints)


class Sampler:
    """Takes one sample of a procedure: projects its frames, waits for the shots, measures."""

    def __init__(
        self, node: Node, procedure: Procedure, shots: Shots, background: Background, *, projection_settle: float
    ) -> None:
        """``projection_settle`` [s] from the acknowledgement of a frame to the first image that counts."""
        self._node, self._procedure, self._shots, self._background = node, procedure, shots, background
        self._settle = round(1e9 * projection_settle)
        self._projection = Projection(node) if procedure.source is Source.IMAGES else None

    async def take(self, timeout: float, setup: Setup) -> Sample:
        """Return a sample taken from now on; ``timeout`` [s] for each image. Raises StructuredLightError."""
        frames = self._procedure.frames(setup)
        if frames:
            return await self._measure(await self._sequence(timeout, setup), setup)
        end, after = time.monotonic() + timeout, self._node.get_clock().now().nanoseconds
        reason: StructuredLightError | None = None
        while True:
            left = end - time.monotonic()
            try:
                shot = await self._shots.next(max(left, 1e-3) if reason else timeout, after)
            except InvalidInputError as error:
                raise InvalidInputError(f"no usable view within {timeout:g} s: {reason}") if reason else error from None
            try:
                return await self._measure(shot, setup)
            except StructuredLightError as error:
                reason, after = error, shot.stamp + 1

    async def _sequence(self, timeout: float, setup: Setup) -> Shot:
        """Project all frames, one image of each; the dots are shown again at the end."""
        assert self._projection is not None
        taken = []
        try:
            for frame in self._procedure.frames(setup):
                shown = await self._projection.show(frame)
                taken.append(await self._shots.next(timeout, shown + self._settle))
        finally:
            await self._projection.show_pattern()
        last = taken[-1]
        pictures = tuple(image for shot in taken for image in shot.images)
        return Shot(last.stamp, images=pictures, base_from_flange=last.base_from_flange, joints=last.joints)

    async def _measure(self, shot: Shot, setup: Setup) -> Sample:
        """Measure, images in the background: finding a board takes a while."""
        if self._procedure.source is Source.DOTS:
            return self._procedure.measure(shot, setup)
        if self._background.busy:
            raise InvalidInputError("a computation is running")
        sample = await self._background.run(lambda: self._procedure.measure(shot, setup))
        assert isinstance(sample, Sample)
        return sample
