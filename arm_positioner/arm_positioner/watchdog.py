"""What makes an arm stop: each check compares one number with its limit and says so in a sentence with both."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from arm_positioner.errors import Code
from arm_positioner.singularity import SingularityThresholds
from arm_positioner.task import Kind, Outcome, Task

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """Times and tolerances.

    Attributes:
        joint_timeout: Age of the joint states past which the arm is stopped [s].
        target_timeout: Age past which a streamed target is refused, or stops the arm [s].
        cloud_timeout: Time without a usable cloud past which the arm is stopped [s].
        lost_timeout: Time that a task waits at rest for its cause to pass before it ends [s].
        deviation: Largest distance of a measured joint from what was commanded [rad or m].
        driver_lag: Longest delay between a setpoint and the joint being there [s].
        settle_timeout: Time after the last setpoint within which the arm has to be at the target [s].
        position_tolerance: Of the target [m].
        orientation_tolerance: Of the target [rad].
        rest_motion: Change of a joint within 0.1 s that still counts as rest [rad or m].
        drift: Change of a joint since the last motion past which somebody else has moved the arm [rad or m].
        thresholds: Condition numbers.
    """

    joint_timeout: float = 0.1
    target_timeout: float = 0.1
    cloud_timeout: float = 1.0
    lost_timeout: float = 5.0
    deviation: float = 0.05
    driver_lag: float = 0.25
    settle_timeout: float = 2.0
    position_tolerance: float = 1e-3
    orientation_tolerance: float = 5e-3
    rest_motion: float = 1e-3
    drift: float = 5e-4
    thresholds: SingularityThresholds = field(default_factory=SingularityThresholds)


def stale_joints(age: float, options: WatchOptions) -> Outcome | None:
    """Check the age of the newest joint state [s]."""
    if age <= options.joint_timeout:
        return None
    text = f"joint states are {age:.3f} s old" if np.isfinite(age) else "no joint state received yet"
    return Outcome(Code.STALE_JOINTS, f"{text}, limit {options.joint_timeout:g} s")


def deviation(off: Array, names: tuple[str, ...], options: WatchOptions) -> Outcome | None:
    """Check how far the measured joints (n,) are off the setpoints of the driver's lag [rad or m]."""
    if not (off > options.deviation).any():
        return None
    i = int(np.argmax(off))
    return Outcome(
        Code.DRIVER_DEVIATION,
        f"joint {names[i]} is {off[i]:.4f} off its setpoints of the last {options.driver_lag:g} s, "
        f"limit {options.deviation:g}",
    )


def stale_target(task: Task, now: float, options: WatchOptions) -> Outcome | None:
    """Check the age of a streamed target."""
    age = now - task.target_time
    if task.kind is not Kind.SERVO or age <= options.target_timeout:
        return None
    return Outcome(Code.STALE_TARGET, f"target is {age:.3f} s old, limit {options.target_timeout:g} s")


def lost_cloud(task: Task, now: float, options: WatchOptions) -> Outcome | None:
    """Check the age of the last cloud that showed the object."""
    age = now - task.target_time
    if task.kind is not Kind.OBJECT or age <= options.cloud_timeout:
        return None
    return Outcome(Code.LOST_CLOUD, f"no usable point cloud for {age:.2f} s, limit {options.cloud_timeout:g} s")


def waited_too_long(task: Task, now: float, options: WatchOptions) -> Outcome | None:
    """Check how long a task has been held at rest."""
    if task.held is None or now - task.held_since <= options.lost_timeout:
        return None
    return Outcome(task.held.code, f"{task.held.message}; given up after {options.lost_timeout:g} s")


def singular(condition: float, options: WatchOptions) -> Outcome:
    """Say that the condition number is past the limit."""
    return Outcome(Code.SINGULARITY, f"condition number {condition:.0f} past the limit {options.thresholds.stop:.0f}")


def arrival(
    task: Task, error: tuple[float, float], now: float, options: WatchOptions, settled: bool
) -> tuple[Outcome, bool] | None:
    """Judge an arm that has sent its last setpoint towards the target.

    Args:
        task: With the time since when no setpoint has left.
        error: Distance [m] and angle [rad] from the target.
        now: Time [s].
        options: Tolerances.
        settled: Whether the arm has been measured at rest.

    Returns what to report and whether the task is over; None: wait.
    """
    distance, angle = error
    numbers = f"{1e3 * distance:.2f} mm and {np.degrees(angle):.3f} deg from the target"
    near = distance <= options.position_tolerance and angle <= options.orientation_tolerance
    if task.follow:
        return Outcome(Code.FOLLOWING, f"following, {numbers}"), False
    if near and settled:
        streamed = task.kind is Kind.SERVO and now - task.target_time <= options.target_timeout
        return Outcome(Code.REACHED, f"at rest, {numbers}"), not streamed
    if task.rest_since is not None and now - task.rest_since > options.settle_timeout:
        waited = f"{numbers} {options.settle_timeout:g} s after the last setpoint"
        return Outcome(Code.DRIVER_DEVIATION, waited), True
    return None
