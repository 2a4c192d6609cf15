"""Long computations beside a single-threaded executor."""

import os
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from rclpy.node import Node
from rclpy.task import Future

_THREADS = "background"


class Background:
    """Runs one function at a time in a thread; the node goes on answering meanwhile."""

    def __init__(self, node: Node, period: float = 0.1) -> None:
        self._node, self._period = node, period
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix=_THREADS)
        self.busy = False

    async def run(self, function: Callable[[], Any]) -> Any:
        """Return the function's result; its exceptions are raised here."""
        self.busy = True
        job = self._pool.submit(function)
        done: Future = Future()
        # Polled, as a future of rclpy must be set in the executor's own thread.
        timer = self._node.create_timer(self._period, lambda: job.done() and not done.done() and done.set_result(None))
        try:
            await done
        finally:
            self._node.destroy_timer(timer)
            self.busy = False
        return job.result()

    def close(self) -> None:
        """Forget what still waits; a running computation ends with the process, see :func:`end_process`."""
        self._pool.shutdown(wait=False, cancel_futures=True)


def end_process(code: int) -> int:
    """Return the exit code, or end the process with it where a computation still runs.

    Nothing can interrupt it, its result is wanted no more, and Python would wait for it.
    """
    if any(thread.name.startswith(_THREADS) for thread in threading.enumerate()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code
