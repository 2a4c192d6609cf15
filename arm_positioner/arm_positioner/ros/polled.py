"""Subscriptions that are read when it suits the reader instead of by an executor.

The setpoint thread takes the joint states itself: no executor, busy with a cloud or a goal, can make them late.
"""

from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile

_MOST = 100
"""Messages taken at once; the rest waits for the next time."""


class _NeverExecuted(CallbackGroup):
    """Keeps an entity out of the executor's wait set."""

    def can_execute(self, entity: Any) -> bool:
        return False

    def beginning_execution(self, entity: Any) -> bool:
        return False

    def ending_execution(self, entity: Any) -> None:
        pass


class PolledSubscription:
    """A subscription without callback."""

    def __init__(self, node: Node, message_type: Any, topic: str, qos: QoSProfile) -> None:
        self._subscription = node.create_subscription(
            message_type, topic, lambda _message: None, qos, callback_group=_NeverExecuted()
        )

    def take(self) -> list[Any]:
        """Return the messages that have arrived since the last call, oldest first."""
        taken: list[Any] = []
        with self._subscription.handle:
            while len(taken) < _MOST:
                item = self._subscription.handle.take_message(self._subscription.msg_type, False)
                if item is None:
                    break
                taken.append(item[0])
        return taken
