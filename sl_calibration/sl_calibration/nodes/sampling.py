"""Taking samples: the next usable correspondences with the flange pose at their stamp."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.task import Future

from sl_calibration.nodes.messages import dots_from_message
from sl_calibration.nodes.robot import Pairing, Robot
from sl_calibration.self_calibration.views import LEAST_DOTS, View
from sl_calibration.sessions import Sample
from sl_common.errors import InvalidInputError, StructuredLightError
from sl_common.joint_buffer import JointLookupError
from sl_common.ros.stamps import to_ns
from sl_msgs.msg import Correspondences

Array = NDArray[np.float64]

_SPEED_SPAN = 40_000_000  # [ns] over which the joint speed before an image is measured


@dataclass(frozen=True, kw_only=True)
class SamplingLimits:
    """What a usable view is.

    Attributes:
        min_confidence: Dots of lower confidence are left out.
        least_dots: Fewest dots.
        max_joint_speed: Largest speed of any joint at the image [rad/s]: latency and exposure must not count.
    """

    min_confidence: float = 0.9
    least_dots: int = 60
    max_joint_speed: float = 0.01


class Sampler:
    """Hands out the next usable view after a moment."""

    def __init__(self, node: Node, robot: Robot, limits: SamplingLimits, *, wait: float) -> None:
        self._node, self._robot, self._limits = node, robot, limits
        self._pairing: Pairing[Correspondences] = Pairing(
            node, robot, wait=wait, deliver=self._deliver, refuse=lambda _, reason: self._refuse(reason)
        )
        self._waiting: Future | None = None
        self._after = 0
        self._reason = ""
        self._pattern_id = ""
        self.last_dots = 0

    def add(self, message: Correspondences) -> None:
        """Take correspondences in; those not waited for are dropped."""
        self.last_dots = len(message.row)
        if self._waiting is not None and to_ns(message.header.stamp) >= self._after:
            self._pairing.add(to_ns(message.header.stamp), message)

    async def next(self, timeout: float, pattern_id: str) -> Sample:
        """Return the next view taken from now on.

        Raises InvalidInputError with the reason of the last refusal when none comes within ``timeout`` [s], or when
        another sample is being taken.
        """
        if self._waiting is not None:
            raise InvalidInputError("another sample is being taken")
        self._waiting, self._pattern_id = Future(), pattern_id
        self._after = self._node.get_clock().now().nanoseconds
        self._reason = "no correspondences received: is the decoder running and the pattern shown?"
        timer = self._node.create_timer(timeout, self._expire)
        try:
            result = await self._waiting
        finally:
            self._waiting = None
            self._node.destroy_timer(timer)
        if result is None:
            raise InvalidInputError(f"no usable view within {timeout:g} s: {self._reason}")
        assert isinstance(result, Sample)
        return result

    def _expire(self) -> None:
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)

    def _refuse(self, reason: str) -> None:
        self._reason = reason

    def _deliver(self, message: Correspondences, base_from_flange: Array) -> None:
        if self._waiting is None or self._waiting.done():
            return
        stamp = to_ns(message.header.stamp)
        try:
            sample = self._sample(message, stamp, base_from_flange)
        except StructuredLightError as error:
            self._reason = str(error)
            return
        self._waiting.set_result(sample)

    def _sample(self, message: Correspondences, stamp: int, base_from_flange: Array) -> Sample:
        if message.pattern_id != self._pattern_id:
            raise InvalidInputError(f"correspondences of pattern '{message.pattern_id}', expected '{self._pattern_id}'")
        dots = dots_from_message(message)
        keep = (dots.confidence >= self._limits.min_confidence) & np.isfinite(dots.camera).all(-1)
        least = max(self._limits.least_dots, LEAST_DOTS)
        if keep.sum() < least:
            raise InvalidInputError(f"{int(keep.sum())} dots of {len(keep)} are sure enough, {least} are needed")
        joints = self._robot.positions_at(stamp)
        try:
            before = self._robot.positions_at(stamp - _SPEED_SPAN)
        except JointLookupError as error:
            raise InvalidInputError(f"whether the robot rests is not known: {error}") from None
        speed = float(np.abs(joints - before).max()) / (1e-9 * _SPEED_SPAN)
        if speed > self._limits.max_joint_speed:
            raise InvalidInputError(
                f"the robot moves at {speed:.3f} rad/s, limit {self._limits.max_joint_speed:g}: bring it to rest"
            )
        view = View(f"view_{stamp}", dots.row[keep], dots.col[keep], dots.camera[keep], base_from_flange, stamp)
        return Sample(view, joints)
