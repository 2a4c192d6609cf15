"""Playing a bag into running nodes, with /clock."""

import importlib
import time
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock

from sl_bringup.bag.reader import BagReader, Topic
from sl_bringup.errors import BagError
from sl_common.ros.qos import LATCHED
from sl_common.ros.stamps import from_ns

_CLOCK_PERIOD = 0.01
"""Longest time between two messages on /clock [s]."""
_STREAM = QoSProfile(depth=250)
"""Reliable, and deep enough (two seconds of joint states) that none is replaced before a slow listener has it."""


class Player:
    """Publishes a bag's messages, as they were serialised, at the times they were recorded.

    Latched topics are published latched, all others reliable. /clock shows the
    bag's time, for nodes with use_sim_time.
    """

    def __init__(self, node: Node, bag: BagReader, *, rate: float = 1.0, clock: bool = True) -> None:
        """Create the publishers.

        Args:
            node: Owner of the publishers.
            bag: What to play.
            rate: 2.0 plays twice as fast.
            clock: Publish /clock.

        Raises BagError for a message type that is not installed.
        """
        self._bag, self._rate = bag, rate
        self._publishers: dict[str, Publisher] = {t.name: _publisher(node, t) for t in bag.topics}
        self._clock = node.create_publisher(Clock, "/clock", 10) if clock else None
        self.published = 0

    def subscribers(self) -> dict[str, int]:
        """Return the number of matched subscribers by topic."""
        return {topic: p.get_subscription_count() for topic, p in self._publishers.items()}

    def play(self, stop: Callable[[], bool] = lambda: False) -> Iterator[float]:
        """Publish all messages in time, yielding the time played [s] after each; ``stop`` ends it early."""
        origin = time.monotonic()
        first = self._bag.start
        for topic, stamp, data in self._bag.messages():
            due = origin + (stamp - first) * 1e-9 / self._rate
            while (remaining := due - time.monotonic()) > 0 and not stop():
                self._tick(first, origin)
                time.sleep(min(remaining, _CLOCK_PERIOD))
            if stop():
                return
            if self._clock is not None:
                self._clock.publish(Clock(clock=from_ns(stamp)))
            self._publishers[topic].publish(data)
            self.published += 1
            yield (stamp - first) * 1e-9

    def _tick(self, first: int, origin: float) -> None:
        if self._clock is not None:
            now = first + round((time.monotonic() - origin) * self._rate * 1e9)
            self._clock.publish(Clock(clock=from_ns(now)))


def _publisher(node: Node, topic: Topic) -> Publisher:
    return node.create_publisher(message_class(topic), topic.name, LATCHED if topic.latched else _STREAM)


def message_class(topic: Topic) -> Any:
    """Return the Python class of a topic's messages; raises BagError when it is not installed."""
    try:
        package, kind, name = topic.type_name.split("/")
        return getattr(importlib.import_module(f"{package}.{kind}"), name)
    except (AttributeError, ImportError, ValueError):
        raise BagError(f"topic {topic.name} is of type {topic.type_name}, which is not installed here") from None
