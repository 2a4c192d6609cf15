"""``ros2 run sl_bringup replay``: plays a bag into the running nodes."""

import argparse
import signal
import sys
import time
from pathlib import Path
from types import FrameType

import rclpy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from sl_bringup.bag.player import Player
from sl_bringup.bag.reader import BagReader
from sl_bringup.terminal import Terminal
from sl_common.errors import StructuredLightError

_EPILOG = """example:
  ros2 run sl_decoder decoder --ros-args -p use_sim_time:=true &
  ros2 run sl_calibration triangulator --ros-args -p use_sim_time:=true -p calibration_folder:=bags/wavy/calibration &
  ros2 run sl_bringup replay bags/wavy/bag --rate 0.5 --loop

Messages keep their stamps; /clock shows the bag's time. To remap a topic:
--ros-args -r /camera/image_raw:=/image"""


class _Stop:
    """Remembers SIGINT and SIGTERM."""

    def __init__(self) -> None:
        self._asked = False
        signal.signal(signal.SIGINT, self._ask)
        signal.signal(signal.SIGTERM, self._ask)

    def __call__(self) -> bool:
        return self._asked

    def _ask(self, _signal: int, _frame: FrameType | None) -> None:
        self._asked = True


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    """Read the command line; ROS arguments are left to rclpy."""
    parser = argparse.ArgumentParser(
        prog="ros2 run sl_bringup replay",
        description="Play a bag into the running nodes, with /clock, each topic with the QoS it was recorded with.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("bag", type=Path, help="the bag's folder (or a folder of record_bag, or the .mcap file)")
    parser.add_argument("--rate", type=float, default=1.0, help="2 plays twice as fast (default: %(default)s)")
    parser.add_argument("--loop", action="store_true", help="play again and again until Ctrl-C")
    parser.add_argument("--no-clock", action="store_true", help="publish no /clock")
    parser.add_argument(
        "--wait",
        type=float,
        default=10.0,
        help="longest wait for a subscriber of some topic before playing [s] (default: %(default)s)",
    )
    words = sys.argv[1:] if arguments is None else arguments
    options = parser.parse_args(remove_ros_args(["replay", *words])[1:])
    if not 0.01 <= options.rate <= 100:
        parser.error(f"--rate {options.rate:g} is not within 0.01 to 100")
    return options


def run(options: argparse.Namespace, arguments: list[str] | None = None) -> None:
    """Play the bag; raises StructuredLightError where it cannot be read."""
    stop, terminal = _Stop(), Terminal()
    folder = options.bag / "bag" if (options.bag / "bag" / "metadata.yaml").is_file() else options.bag
    with BagReader(folder) as bag:
        rclpy.init(
            args=sys.argv if arguments is None else ["replay", *arguments],
            signal_handler_options=SignalHandlerOptions.NO,
        )
        node = rclpy.create_node("replay")
        try:
            player = Player(node, bag, rate=options.rate, clock=not options.no_clock)
            counts = ", ".join(f"{t.name} ({t.count})" for t in bag.topics)
            terminal.step(f"{folder}: {bag.duration:.1f} s, {counts}")
            _await_subscribers(player, options.wait, stop, terminal)
            while not stop():
                for seconds in player.play(stop):
                    terminal.live(f"{seconds:.1f} of {bag.duration:.1f} s")
                if not options.loop:
                    break
            if not stop():
                time.sleep(0.5)  # the last messages are on their way
            terminal.step(f"{player.published} messages published")
        finally:
            node.destroy_node()
            rclpy.try_shutdown()


def _await_subscribers(player: Player, timeout: float, stop: _Stop, terminal: Terminal) -> None:
    """Wait until somebody listens, then a moment longer for the others to be found."""
    deadline = time.monotonic() + timeout
    while not any(player.subscribers().values()) and not stop():
        if time.monotonic() > deadline:
            terminal.step(f"nobody subscribes after {timeout:.0f} s: playing all the same")
            return
        terminal.live("waiting for a subscriber")
        time.sleep(0.05)
    time.sleep(1.0)
    silent = [topic for topic, count in player.subscribers().items() if count == 0]
    if silent:
        terminal.step(f"without a subscriber: {', '.join(silent)}")


def main(arguments: list[str] | None = None) -> int:
    """Run the command."""
    options = parse(arguments)
    try:
        run(options, arguments)
    except StructuredLightError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
