"""``ros2 run sl_bringup replay``: plays a bag into the running nodes."""

import argparse
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from sl_bringup.bag.reader import BagReader
from sl_bringup.ros.participant import own_node, without_ros_arguments
from sl_bringup.ros.player import Player
from sl_bringup.terminal import Terminal
from sl_common.commands import UsageError, make_parser, run_command

_EXAMPLE = """  ros2 run sl_decoder decoder --ros-args -p use_sim_time:=true &
  ros2 run sl_calibration triangulator --ros-args -p use_sim_time:=true -p calibration_folder:=bags/wavy/calibration &
  ros2 run sl_bringup replay bags/wavy/bag --rate 0.5 --loop

Messages keep their stamps; /clock shows the bag's time. To remap a topic:
--ros-args -r /camera/image_raw:=/image"""


_SETTLED = 1.5
"""After this time without a new subscriber [s] all are there."""


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


def _parser() -> argparse.ArgumentParser:
    parser = make_parser(
        "sl_bringup replay",
        "Play a bag into the running nodes, with /clock, each topic with the QoS it was recorded with.",
        _EXAMPLE,
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
    return parser


def _run(options: argparse.Namespace, words: Sequence[str]) -> None:
    """Play the bag; ``words`` may hold ROS arguments. Raises StructuredLightError where the bag cannot be read."""
    if not 0.01 <= options.rate <= 100:
        raise UsageError(f"--rate {options.rate:g} is not within 0.01 to 100")
    stop, terminal = _Stop(), Terminal()
    folder = options.bag / "bag" if (options.bag / "bag" / "metadata.yaml").is_file() else options.bag
    with BagReader(folder) as bag, own_node("replay", words) as node:
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


def _await_subscribers(player: Player, timeout: float, stop: _Stop, terminal: Terminal) -> None:
    """Wait until somebody listens, then until nobody new has been found for a while."""
    begin = since = time.monotonic()
    counts = player.subscribers()
    while not stop() and not (any(counts.values()) and time.monotonic() - since > _SETTLED):
        if time.monotonic() - begin > timeout and not any(counts.values()):
            terminal.step(f"nobody subscribes after {timeout:.0f} s: playing all the same")
            return
        terminal.live("waiting for a subscriber")
        time.sleep(0.05)
        if (found := player.subscribers()) != counts:
            counts, since = found, time.monotonic()
    silent = [topic for topic, count in counts.items() if count == 0]
    if silent:
        terminal.step(f"without a subscriber: {', '.join(silent)}")


def main(arguments: list[str] | None = None) -> int:
    """Run the command; ROS arguments are left to rclpy."""
    words = sys.argv[1:] if arguments is None else arguments
    return run_command(_parser(), lambda options: _run(options, words), without_ros_arguments(words))


if __name__ == "__main__":
    sys.exit(main())
