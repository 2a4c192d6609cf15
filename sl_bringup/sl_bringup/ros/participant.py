"""This process as a part of the ROS graph, for commands that watch nodes or feed them and handle signals themselves."""

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar, cast

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

T = TypeVar("T")

_POLL = 0.002
"""Between two looks for a result [s]."""
_END = 2.0
"""Longest wait for the thread that serves callbacks to end [s]."""


def without_ros_arguments(words: Sequence[str]) -> list[str]:
    """Return the words of a command line that are not for rclpy (``--ros-args ...``)."""
    return list(remove_ros_args(["command", *words])[1:])


@contextmanager
def participating(words: Sequence[str] = (), *, domain: int | None = None) -> Iterator[None]:
    """Bring rclpy up, with the ROS arguments among ``words``, and down again; signals stay the caller's."""
    arguments = ["command", *words]
    rclpy.init(args=arguments, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield
    finally:
        rclpy.try_shutdown()


@contextmanager
def own_node(name: str, words: Sequence[str] = ()) -> Iterator[Node]:
    """Take part with a node that only publishes, or whose callbacks the caller serves."""
    with participating(words):
        node = Node(name)
        try:
            yield node
        finally:
            node.destroy_node()


class Thread:
    """The thread that calls a node's callbacks."""

    def __init__(self, node: Node) -> None:
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._thread = threading.Thread(target=_spin, args=(self._executor,), name=node.get_name(), daemon=True)
        self._thread.start()

    def run(self, function: Callable[[], T]) -> T:
        """Run ``function`` between two callbacks and return its result.

        An action client must be used in this way: an answer that arrives in this thread before the caller's has noted
        the request is dropped (rclpy 7.1). So must whatever makes or destroys a part of the node: this thread may be
        about to wait for it.
        """
        task = self._executor.create_task(function)
        while not task.done():
            time.sleep(_POLL)
        return cast(T, task.result())

    def stop(self) -> None:
        """Call no more callbacks."""
        self._executor.shutdown(timeout_sec=_END)
        self._thread.join(timeout=_END)


@contextmanager
def served(node: Node) -> Iterator[Thread]:
    """Call the node's callbacks from a thread of their own; the node is destroyed at the end."""
    thread = Thread(node)
    try:
        yield thread
    finally:
        thread.stop()
        node.destroy_node()


def _spin(executor: SingleThreadedExecutor) -> None:
    try:
        executor.spin()
    except ExternalShutdownException:
        pass
