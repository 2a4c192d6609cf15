"""Running a node: one clear line on failure, a clean stop on SIGINT and SIGTERM."""

import signal
import sys
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from sl_common.errors import StructuredLightError


class _Stop(Exception):  # noqa: N818 (not an error)
    """A signal asked the process to end."""


def run_node(
    factory: Callable[[], Node], args: Sequence[str] | None = None, executor: Callable[[], Executor] | None = None
) -> int:
    """Create a node, spin it until SIGINT or SIGTERM, and return the process's exit code.

    The context stays valid until the node is gone, so that ``destroy_node`` can still publish (the positioner brings
    the arm to rest there). A StructuredLightError from the factory is logged as one line and gives exit code 1.

    Args:
        factory: Builds the node; called after rclpy.init.
        args: Command line for rclpy; None: sys.argv.
        executor: Builds the executor; None: a single-threaded one.
    """

    def stop(_signal: int, _frame: FrameType | None) -> None:
        raise _Stop

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
    node: Node | None = None
    try:
        rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
        spinner = executor() if executor else SingleThreadedExecutor()
        node = factory()
        spinner.add_node(node)
        while rclpy.ok():
            spinner.spin_once(timeout_sec=1.0)
    except (_Stop, ExternalShutdownException, KeyboardInterrupt):
        pass
    except (StructuredLightError, InvalidParameterTypeException, InvalidParameterValueException) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        if node is not None:
            node.destroy_node()
        if rclpy.ok():
            rclpy.shutdown()
    return 0
