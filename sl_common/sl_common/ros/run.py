"""Running a node: one clear line on failure, a clean stop on SIGINT and SIGTERM."""

import signal
import sys
import time
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from sl_common.errors import StructuredLightError

_PATIENCE = 0.2
"""Time [s] that a quiet node takes at most to see that it was asked to stop."""

_INSISTENCE = 1.0
"""Time [s] after the first signal from which another one means it: Ctrl-C in a launch's terminal comes twice."""


class _Stop(Exception):  # noqa: N818 (not an error)
    """A signal asked the process to end, and nothing is lost if it ends here."""


class _Signals:
    """SIGINT and SIGTERM as a wish to stop.

    A first signal interrupts the node's construction, but never a callback: an exception that comes out of the middle
    of one may surface anywhere, inside foreign code too. A callback that lets a first signal wait is interrupted by
    a later one.
    """

    def __init__(self) -> None:
        self.asked = False
        self.interrupts = True
        self._since = 0.0
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, _signal: int, _frame: FrameType | None) -> None:
        now = time.monotonic()
        if not self.asked:
            self.asked, self._since = True, now
        if self.interrupts or now - self._since > _INSISTENCE:
            raise _Stop

    def ignore(self) -> None:
        """Leave the node's end undisturbed."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def run_node(
    factory: Callable[[], Node], args: Sequence[str] | None = None, executor: Callable[[], Executor] | None = None
) -> int:
    """Create a node, spin it until SIGINT or SIGTERM, and return the process's exit code.

    A callback that runs when the signal comes is finished first. The context stays valid until the node is gone, so
    that ``destroy_node`` can still publish (the positioner brings the arm to rest there). A StructuredLightError from
    the factory is logged as one line and gives exit code 1.

    Args:
        factory: Builds the node; called after rclpy.init.
        args: Command line for rclpy; None: sys.argv.
        executor: Builds the executor; None: a single-threaded one.
    """
    signals = _Signals()
    node: Node | None = None
    try:
        rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
        spinner = executor() if executor else SingleThreadedExecutor()
        node = factory()
        spinner.add_node(node)
        signals.interrupts = False
        while rclpy.ok() and not signals.asked:
            spinner.spin_once(timeout_sec=_PATIENCE)
    except (_Stop, ExternalShutdownException, KeyboardInterrupt):
        pass
    except (StructuredLightError, InvalidParameterTypeException, InvalidParameterValueException) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except Exception:
        if not signals.asked:  # else it is the interruption, which foreign code passed on as an exception of its own
            raise
    finally:
        signals.ignore()
        if node is not None:
            node.destroy_node()
        if rclpy.ok():
            rclpy.shutdown()
    return 0
