"""/diagnostics at 1 Hz (REP-107): rates of what passes through a node, key values, and one level with its reason."""

import threading
import time
from collections import Counter, deque
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR

_WINDOW = 5.0


class Diagnostics:
    """Collects a node's figures, from any thread, and publishes them once a second."""

    def __init__(self, node: Node, hardware_id: str = "") -> None:
        self._node = node
        self._hardware_id = hardware_id
        self._level, self._message = OK, "starting"
        self._values: dict[str, str] = {}
        self._times: dict[str, deque[float]] = {}
        self._counts: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._timer = node.create_timer(1.0, self.publish)

    def tick(self, name: str) -> None:
        """Count one event of ``name`` (an image received, a cloud published): its rate [1/s] and total are reported."""
        now = time.monotonic()
        with self._lock:
            self._times.setdefault(name, deque(maxlen=2000)).append(now)
            self._counts[name] += 1

    def set(self, key: str, value: Any) -> None:
        """Set a key value; floats are shown with four significant digits."""
        text = f"{value:.4g}" if isinstance(value, float) else str(value)
        with self._lock:
            self._values[key] = text

    def level(self, level: bytes, message: str) -> None:
        """Set the level (OK, WARN or ERROR) and the sentence that says why."""
        self._level, self._message = level, message

    def rate(self, name: str) -> float:
        """Return the rate of ``name`` over the last five seconds [1/s]."""
        now = time.monotonic()
        with self._lock:
            recent = [t for t in self._times.get(name, ()) if now - t <= _WINDOW]
        return (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 else 0.0

    def publish(self) -> None:
        """Publish now; called by the timer."""
        with self._lock:
            values, counts = dict(self._values), dict(self._counts)
        for name, count in counts.items():
            values[f"{name} rate [1/s]"] = f"{self.rate(name):.4g}"
            values[f"{name} total"] = str(count)
        status = DiagnosticStatus(
            level=self._level,
            name=self._node.get_fully_qualified_name().lstrip("/"),
            message=self._message,
            hardware_id=self._hardware_id,
            values=[KeyValue(key=k, value=v) for k, v in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
