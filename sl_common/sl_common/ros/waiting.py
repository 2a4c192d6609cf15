"""Says which inputs a node still waits for, so that no output never means no reason."""

from dataclasses import dataclass
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile

from sl_common.ros.qos import describe


@dataclass
class _Input:
    type_name: str
    qos: str


class InputWatch:
    """Logs every five seconds which expected topics have not delivered yet, with type, QoS and number of publishers."""

    def __init__(self, node: Node, period: float = 5.0) -> None:
        self._node = node
        self._missing: dict[str, _Input] = {}
        self._timer = node.create_timer(period, self._report)

    def expect(self, topic: str, message_type: Any, qos: QoSProfile) -> None:
        """Register an input by the topic name given to create_subscription."""
        module = message_type.__module__.split(".")
        self._missing[topic] = _Input(f"{module[0]}/{module[1]}/{message_type.__name__}", describe(qos))

    def seen(self, topic: str) -> None:
        """Mark an input as delivering."""
        self._missing.pop(topic, None)

    @property
    def missing(self) -> tuple[str, ...]:
        """Topics not seen yet."""
        return tuple(self._missing)

    def _report(self) -> None:
        for topic, wanted in self._missing.items():
            resolved = self._node.resolve_topic_name(topic)
            publishers = self._node.count_publishers(resolved)
            hint = (
                "no publisher"
                if publishers == 0
                else f"{publishers} publisher(s), but nothing usable received: check QoS and type"
            )
            self._node.get_logger().info(f"waiting for {resolved} ({wanted.type_name}; {wanted.qos}): {hint}")
        if not self._missing:
            self._node.destroy_timer(self._timer)
