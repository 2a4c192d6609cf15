"""The acts of the demo, in order. Each prints what it does and raises DemoError with the reason where it fails."""

import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from sl_bringup import nominal_calibration
from sl_bringup.errors import DemoError
from sl_bringup.ros.observer import DECODER
from sl_bringup.ros.session import Session
from sl_bringup.terminal import Terminal
from sl_common.ros.stamps import to_ns
from sl_msgs.action import PositionArm
from sl_msgs.msg import PositionerStatus

_START_UP = 120.0
"""Longest wait for each input after the start [s]: a busy machine takes long to load seven Pythons."""

_ORDERS = 5
_PASSING = (PositionerStatus.STALE_JOINTS, PositionerStatus.STALE_TARGET, PositionerStatus.LOST_CLOUD)


@dataclass(frozen=True, eq=False)
class Motion:
    """What came of an order to the arm.

    Attributes:
        result: Of the action.
        begin: When it was ordered first [ns].
        orders: How often it was ordered: again where the arm stopped for a passing reason.
    """

    result: PositionArm.Result
    begin: int
    orders: int


def wait_until_running(session: Session, terminal: Terminal) -> None:
    """Wait until pattern, images and joint states arrive and dots are decoded."""
    observer = session.observer
    started = time.monotonic()
    for topic, what in (
        ("pattern", "the pattern (pattern_publisher)"),
        ("joint_states", "joint states (cell)"),
        ("camera/image_raw", "camera images (cell)"),
        ("correspondences", "decoded dots (decoder)"),
    ):
        waiting = f"waiting for {what}"
        session.wait_for(partial(observer.latest.get, topic), _START_UP, what, partial(str, waiting))
    session.wait_for(lambda: observer.truth is not None, 20.0, "the cell's truth, for the report")
    image = observer.latest["camera/image_raw"]
    pattern = observer.latest["pattern"]
    terminal.step(
        f"running after {time.monotonic() - started:.0f} s: {len(session.processes.processes)} processes, ROS domain "
        f"{session.domain}; camera {image.width}x{image.height}, pattern {pattern.rows}x{pattern.cols}"
    )


def use_nominal_calibration(session: Session, terminal: Terminal, folder: Path, seed: int) -> None:
    """Write the calibration folder from the cell's nominal values, with realistic errors."""
    truth = session.observer.truth
    assert truth is not None
    note = "nominal values of the simulated cell with normally distributed errors; not the result of a calibration"
    calibration = nominal_calibration.perturbed(truth.calibration, seed)
    pattern_id = session.observer.latest["pattern"].pattern_id
    nominal_calibration.save(folder, calibration, note=note, pattern_id=pattern_id)
    terminal.step(f"calibration: nominal values with realistic errors, in {folder}")


def look(session: Session, terminal: Terminal, clouds: int = 5) -> None:
    """Wait for point clouds."""
    observer = session.observer
    first = len(observer.record.clouds)
    session.wait_for(
        lambda: len(observer.record.clouds) >= first + clouds,
        30.0,
        "point clouds on 'points' (triangulator)",
        lambda: f"{observer.record.dots[-1][1] if observer.record.dots else 0} dots decoded, waiting for point clouds",
    )
    dots, cloud = observer.record.dots[-1][1], observer.record.clouds[-1]
    terminal.step(f"looking: {dots} dots decoded in one image, {len(cloud.points)} points triangulated")


def position(session: Session, terminal: Terminal, *, standoff: float, duration: float) -> Motion:
    """Order the arm to the object and watch it get there.

    An order that ended because a joint state or a cloud came late, as happens on a busy machine, is repeated.
    Raises DemoError when the arm does not get there.
    """
    observer = session.observer
    session.wait_for(observer.position_arm.server_is_ready, 20.0, "the action ~/position_arm (positioner)")
    terminal.step(f"positioning: to {1e3 * standoff:.0f} mm before the object, along its normal")
    begin = observer.get_clock().now().nanoseconds
    for order in range(1, _ORDERS + 1):
        result = _order(session, terminal, PositionArm.Goal(standoff=standoff, duration=duration))
        if result.success:
            terminal.step(f"arrived after {result.duration:.1f} s: {result.message}")
            return Motion(result, begin, order)
        if result.code not in _PASSING or order == _ORDERS:
            break
        terminal.step(f"stopped within the limits: {result.message}; ordering again")
        session.wait(1.0)
    raise DemoError(f"the motion ended with code {result.code}: {result.message}")


def _order(session: Session, terminal: Terminal, goal: PositionArm.Goal) -> PositionArm.Result:
    """Send one goal and return its result; raises DemoError where it is refused or never ends."""
    observer = session.observer
    latest: list[PositionArm.Feedback] = []

    def feedback(message: PositionArm.Impl.FeedbackMessage) -> None:
        latest[:] = [message.feedback]

    def live() -> str:
        dots = observer.record.dots[-1][1] if observer.record.dots else 0
        if not latest:
            return f"{dots} dots"
        f = latest[0]
        return (
            f"{1e3 * f.distance:6.1f} mm, {np.degrees(f.angle):5.2f} deg to go; {dots} dots; "
            f"condition {f.condition_number:.0f}; {f.time_remaining:.1f} s"
        )

    sent = session.thread.run(lambda: observer.position_arm.send_goal_async(goal, feedback_callback=feedback))
    session.wait_for(sent.done, 10.0, "an answer of the positioner to the goal")
    handle = sent.result()
    if not handle.accepted:
        reason = observer.record.statuses[-1][2] if observer.record.statuses else "no reason given"
        raise DemoError(f"the positioner refused the goal: {reason}")
    outcome = session.thread.run(handle.get_result_async)
    session.wait_for(outcome.done, 60.0 + 3 * goal.duration, "the end of the motion", live)
    return outcome.result().result


def look_closely(session: Session, terminal: Terminal, clouds: int = 5) -> None:
    """At the end: clouds and images at rest, one with the decoder's debug overlay."""
    observer = session.observer
    now = observer.get_clock().now().nanoseconds
    session.thread.run(lambda: observer.watch_debug_image(True))
    debug = f"{DECODER}/debug_image"
    try:
        session.wait_for(
            lambda: sum(c.stamp > now for c in observer.record.clouds) >= clouds and debug in observer.latest,
            20.0,
            "point clouds and a debug image at rest",
        )
        session.wait_for(
            lambda: max(observer.record.camera_poses, default=0) > now, 5.0, "the true camera pose, for the report"
        )
    finally:
        session.thread.run(lambda: observer.watch_debug_image(False))
    stamp = to_ns(observer.latest[debug].header.stamp)
    dots = dict(observer.record.dots).get(stamp, observer.record.dots[-1][1])
    terminal.step(f"at rest: {dots} dots decoded, {len(observer.record.clouds[-1].points)} points")
