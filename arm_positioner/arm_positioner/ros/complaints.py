"""Warnings about bad messages: each kind at once, its repetitions now and then."""

import re
import time

from rclpy.node import Node

_DIGITS = re.compile(r"[-+.\d]+(e[-+]?\d+)?")


class Complaints:
    """Logs warnings, but not the same again within a while; texts that differ in numbers only are the same."""

    def __init__(self, node: Node, period: float = 2.0) -> None:
        self._node, self._period = node, period
        self._last: dict[str, float] = {}

    def warn(self, text: str) -> None:
        """Log a warning unless its like was logged less than the period ago."""
        kind, now = _DIGITS.sub("#", text), time.monotonic()
        if now - self._last.get(kind, -self._period) < self._period:
            return
        if len(self._last) > 100:
            self._last.clear()
        self._last[kind] = now
        self._node.get_logger().warning(text)
