"""Driving what the projector shows, with an acknowledgement for each frame."""

import time

from rclpy.node import Node

from pattern_gen.gray_code import Axis
from pattern_gen.projection import FrameRequest, Mode
from sl_calibration.nodes.awaiting import sleep, within
from sl_common.errors import InvalidInputError
from sl_common.ros.stamps import to_ns
from sl_msgs.srv import SetProjection

SERVICE = "pattern_publisher/set_projection"
_ANSWER = 5.0  # [s]


class Projection:
    """The pattern publisher's service, awaited."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._client = node.create_client(SetProjection, SERVICE)

    async def show(self, frame: FrameRequest) -> int:
        """Show a frame and return its stamp [ns]; raises InvalidInputError where it is not shown."""
        end = time.monotonic() + _ANSWER
        while not self._client.service_is_ready() and time.monotonic() < end:
            await sleep(self._node, 0.1)
        if not self._client.service_is_ready():
            raise InvalidInputError(f"pattern_publisher is not running: no service {self._client.srv_name}")
        request = SetProjection.Request(
            mode=int(frame.mode),
            axis=SetProjection.Request.COLUMNS if frame.axis is Axis.COLUMNS else SetProjection.Request.ROWS,
            bit=frame.bit,
            inverse=frame.inverse,
            channel=frame.channel,
            step=frame.step,
        )
        future = self._client.call_async(request)
        if not await within(self._node, future, _ANSWER):
            self._client.remove_pending_request(future)
            raise InvalidInputError(f"no answer of {self._client.srv_name} within {_ANSWER:g} s")
        answer = future.result()
        if not answer.success:
            raise InvalidInputError(f"the projector does not show the frame: {answer.message}")
        return to_ns(answer.stamp)

    async def show_pattern(self) -> None:
        """Show the dots again; a failure is logged only."""
        try:
            await self.show(FrameRequest(mode=Mode.PATTERN))
        except InvalidInputError as error:
            self._node.get_logger().warning(str(error))
