"""Waiting inside coroutines of a single-threaded executor."""

from typing import Any

from rclpy.node import Node
from rclpy.task import Future


async def within(node: Node, future: Future, seconds: float) -> bool:
    """Wait for a future, at most so long; returns whether it is done."""
    if future.done():
        return True
    first: Future = Future()

    def end(_: Any = None) -> None:
        if not first.done():
            first.set_result(None)

    timer = node.create_timer(max(seconds, 1e-3), end)
    future.add_done_callback(end)
    try:
        await first
    finally:
        node.destroy_timer(timer)
    return bool(future.done())


async def sleep(node: Node, seconds: float) -> None:
    """Let the node go on for a while."""
    await within(node, Future(), seconds)
