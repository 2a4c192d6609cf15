"""Driving the arm through a calibration by the positioner's action, which keeps all limits."""

from collections.abc import Awaitable, Callable
from pathlib import Path

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from numpy.typing import NDArray
from rclpy.action import ActionClient
from rclpy.node import Node
from std_msgs.msg import Header

from sl_calibration.motion_plan import Estimate, MotionPlanOptions, first_motions, orbit
from sl_calibration.nodes.awaiting import sleep
from sl_calibration.sessions import Sample
from sl_common import transforms
from sl_common.calibration_files import HAND_EYE_FILE, load_hand_eye
from sl_common.errors import InvalidInputError, StructuredLightError
from sl_msgs.action import PositionArm

Array = NDArray[np.float64]

TakeSample = Callable[[], Awaitable[Sample]]
GetEstimate = Callable[[], Estimate | None]


def pose_message(base_from_flange: Array) -> Pose:
    """Return a pose message of a transform (4, 4)."""
    position, quaternion = transforms.to_quaternion(base_from_flange)
    x, y, z = position
    qx, qy, qz, qw = quaternion
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


class GuidedMotion:
    """Visits flange poses one after the other and takes a sample at each."""

    def __init__(
        self,
        node: Node,
        *,
        base_frame: str,
        calibration_folder: Path,
        options: MotionPlanOptions,
        duration: float,
        settle: float,
        points: Callable[[Sample], int],
        least_points: int,
    ) -> None:
        """``duration`` [s] of each motion, longer where the positioner's limits ask; ``settle`` [s] at rest; ``points``
        of a sample, of which ``least_points`` are wanted for the motions to go on at full size."""
        self._node, self._base_frame, self._folder = node, base_frame, calibration_folder
        self._options, self._duration, self._settle = options, duration, settle
        self._points, self._least_points = points, least_points
        self._client = ActionClient(node, PositionArm, "positioner/position_arm")

    async def run(self, take: TakeSample, estimate: GetEstimate) -> str:
        """Run the whole sequence from the present pose and come back to it; returns a summary.

        Args:
            take: Takes a sample here and returns it; raises StructuredLightError when it cannot.
            estimate: Gives the first estimate from the samples so far.

        Raises:
            InvalidInputError: No positioner, no dots at the start, or too few poses reached.
        """
        if not self._client.server_is_ready():
            raise InvalidInputError("the positioner is not running: no action server positioner/position_arm")
        first = await take()
        start, at_start = first.arrays["base_from_flange"], self._points(first)
        taken, skipped = 1, 0
        scale = 1.0
        for i in range(len(first_motions(start, self._options))):
            reached = await self._visit(first_motions(start, self._options, scale)[i], take)
            taken, skipped = taken + (reached > 0), skipped + (reached == 0)
            if 0 <= reached < max(0.3 * at_start, self._least_points):
                scale *= 0.6  # most dots left the image: smaller steps
        found = estimate()
        if found is None:
            await self._move(start)
            raise InvalidInputError(
                f"{taken} views around the start pose give no first estimate: bring more dots into view at the start"
            )
        scale = 1.0
        for i in range(len(orbit(start, found, self._options))):
            reached = await self._visit(orbit(start, found, self._options, scale)[i], take)
            if reached == 0:  # out of reach or out of sight: half way there
                reached = await self._visit(orbit(start, found, self._options, 0.5 * scale)[i], take)
            taken, skipped = taken + (reached > 0), skipped + (reached == 0)
            if i == 3:
                found = estimate() or found  # the large motions so far sharpen the estimate
        await self._move(start)
        return f"{taken} samples taken, {skipped} poses skipped"

    async def _visit(self, base_from_flange: Array, take: TakeSample) -> int:
        """Go to a flange pose and take a sample; returns its number of dots, 0 where that failed."""
        try:
            await self._move(base_from_flange)
            await sleep(self._node, self._settle)
            return self._points(await take())
        except StructuredLightError as error:
            self._node.get_logger().warning(f"pose skipped: {error}")
            return 0

    async def _move(self, base_from_flange: Array) -> None:
        """Send a pose goal and wait for its end; raises InvalidInputError with the positioner's message."""
        pose = base_from_flange @ self._positioner_hand_eye()
        goal = PositionArm.Goal(
            use_goal_pose=True,
            goal_pose=PoseStamped(
                header=Header(stamp=self._node.get_clock().now().to_msg(), frame_id=self._base_frame),
                pose=pose_message(pose),
            ),
            duration=self._duration,
        )
        handle = await self._client.send_goal_async(goal)
        if not handle.accepted:
            raise InvalidInputError("the positioner refused the goal")
        result = (await handle.get_result_async()).result
        if not result.success:
            raise InvalidInputError(f"the positioner did not get there: {result.message}")

    def _positioner_hand_eye(self) -> Array:
        """The positioner takes camera poses by the hand-eye transform of the folder; without one, flange poses."""
        if not (self._folder / HAND_EYE_FILE).exists():
            return transforms.identity()
        return load_hand_eye(self._folder).transform
