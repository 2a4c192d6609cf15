"""Real node processes in a ROS domain of their own, and a node of the test's to talk to them."""

import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSProfile

from sl_bringup.isolation import environment, free_domain
from sl_bringup.processes import Executable, Process, ProcessGroup
from sl_bringup.ros.participant import Thread

START_UP = 90.0
"""How long a node may take to start on a busy machine [s]."""


def wait_for(condition: Callable[[], Any], timeout: float, what: str = "condition") -> Any:
    """Wait until a condition gives something true and return that; fail the test after the timeout."""
    deadline = time.monotonic() + timeout
    while True:
        value = condition()
        if value:
            return value
        assert time.monotonic() < deadline, f"{what}: not within {timeout:.0f} s"
        time.sleep(0.02)


class Log:
    """What a process printed, from its start or from now on."""

    def __init__(self, process: Process, *, from_now: bool = False) -> None:
        self.process = process
        self._begin = len(process.output()) if from_now else 0

    def text(self) -> str:
        return self.process.output()[self._begin :]

    def lines(self, pattern: str) -> list[str]:
        return [line for line in self.text().splitlines() if re.search(pattern, line)]

    def wait_for(self, pattern: str, timeout: float = 10.0) -> str:
        """Wait for a line that matches and return it."""
        deadline = time.monotonic() + timeout
        while not (found := self.lines(pattern)):
            assert self.process.returncode is None, f"{self.process.label} ended:\n{self.text()}"
            assert time.monotonic() < deadline, (
                f"no line like '{pattern}' from {self.process.label}; it printed:\n{self.text()}"
            )
            time.sleep(0.05)
        return found[0]


class Peer:
    """A node of the test in the domain of the processes; keeps everything it receives."""

    def __init__(self, domain: int, name: str = "test_peer") -> None:
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = Node(name, context=self._context)
        self.received: dict[str, list[Any]] = {}
        self._publishers: dict[str, Any] = {}
        self.thread = Thread(self.node)

    def listen(self, kind: type, topic: str, qos: QoSProfile | int = 10) -> list[Any]:
        """Subscribe; returns the list that messages are appended to."""
        messages = self.received.setdefault(topic, [])
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def publisher(self, kind: type, topic: str, qos: QoSProfile | int = 10) -> Any:
        """Return the publisher of a topic, created on first use."""
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(kind, topic, qos)
        return self._publishers[topic]

    def publish(self, topic: str, message: Any, qos: QoSProfile | int = 10) -> None:
        """Publish once a subscriber is matched."""
        publisher = self.publisher(type(message), topic, qos)
        wait_for(publisher.get_subscription_count, START_UP, f"a subscriber of {topic}")
        publisher.publish(message)

    def call(self, kind: type, name: str, request: Any, timeout: float = START_UP) -> Any:
        """Call a service."""
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(timeout), f"no service {name}"
        future = client.call_async(request)
        wait_for(future.done, timeout, f"answer of {name}")
        return future.result()

    def close(self) -> None:
        self.thread.stop()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


class Stack:
    """Processes and a peer in one domain."""

    def __init__(self, domain: int, group: ProcessGroup) -> None:
        self.domain = domain
        self.group = group
        self.peer = Peer(domain)

    def start(self, package: str, name: str, **parameters: object) -> Process:
        """Start an executable with parameters."""
        return self.group.start(Executable(package, name, parameters=parameters))

    def run(self, executable: Executable) -> Process:
        """Start whatever is described."""
        return self.group.start(executable)


@contextmanager
def running_stack(folder: Path) -> Iterator[Stack]:
    """Yield an empty stack in a domain of its own; whatever is started in it ends with the block."""
    with free_domain() as domain, ProcessGroup(environment(domain), folder / "logs") as group:
        stack = Stack(domain, group)
        try:
            yield stack
        finally:
            stack.peer.close()
