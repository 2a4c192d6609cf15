"""Setpoints out of JointTrajectory messages, joints mapped by name."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from sl_common.errors import InvalidInputError


def trajectory_setpoints(message: Any, names: Sequence[str], period: float) -> list[np.ndarray]:
    """The points' positions, each (n,) in the order of `names`, one per control period [s].

    A trajectory of one point is one setpoint of a stream. Several points must be one control period apart.
    Raises InvalidInputError when joints are missing, sizes disagree or the points' times are not a period apart.
    """
    given = list(message.joint_names)
    missing = [name for name in names if name not in given]
    if missing:
        raise InvalidInputError(
            f"joint_trajectory lacks {', '.join(missing)}; it has: {', '.join(given) or 'no joints'}"
        )
    if not message.points:
        raise InvalidInputError("joint_trajectory has no points")
    order = [given.index(name) for name in names]
    wrong = [k for k, point in enumerate(message.points) if len(point.positions) != len(given)]
    if wrong:
        raise InvalidInputError(
            f"point {wrong[0]} has {len(message.points[wrong[0]].positions)} positions for {len(given)} joint names"
        )
    times = np.array([point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec for point in message.points])
    steps = np.diff(times)
    if len(steps) and (np.abs(steps - period) > 0.02 * period).any():
        raise InvalidInputError(
            f"points are {steps.min():g} to {steps.max():g} s apart; "
            f"this driver takes one point per control period of {period:g} s"
        )
    return [np.asarray(point.positions, float)[order] for point in message.points]
