"""Which of several targets is driven to, and whether a second look at one is better than the first."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from arm_positioner.planning import REFUSALS
from arm_positioner.target import Target
from sl_common.errors import StructuredLightError

T = TypeVar("T")

_MOST = 8
"""Other places tried: each costs a search of inverse kinematics at all rolls of the camera."""
_CONTRADICTION = 3.0
"""Standard deviations by which two looks differ where the object has moved between them."""


def first_possible(
    wanted: Target, others: Callable[[], list[Target]], begin: Callable[[Target], T]
) -> tuple[Target, T, str]:
    """Begin a motion to the target that is wanted, or to the first of the others that the arm can go to.

    Args:
        wanted: The best target.
        others: Returns others, the best first; asked only where they are needed.
        begin: Begins the motion to a target; raises what a planner does where there is no way.

    Returns the target, what ``begin`` returned, and in words where it is and why; empty where it is the one wanted.
    Raises the reason against the one wanted where no other is possible either.
    """
    try:
        return wanted, begin(wanted), ""
    except REFUSALS as error:
        refused = error
    try:
        candidates = others()[:_MOST]
    except StructuredLightError as error:
        raise type(refused)(f"{refused}; nor is another place known: {error}") from error
    for target in candidates:
        try:
            begun = begin(target)
        except REFUSALS:
            continue
        aside = 1e3 * np.linalg.norm(target.surface.point - wanted.surface.point)
        return target, begun, f"{aside:.0f} mm beside the place preferred, for which: {refused}"
    raise type(refused)(f"{refused}; {len(candidates)} other places on the object are no better")


def tells_more(first: Target, second: Target) -> bool:
    """Whether a second look at a place is worth a correction: it is more certain, or contradicts the first."""
    a, b = first.surface, second.surface
    if camera_sigma(second) <= camera_sigma(first):
        return True
    tilt = np.arctan2(np.linalg.norm(np.cross(a.normal, b.normal)), a.normal @ b.normal)
    height = abs(float((b.point - a.point) @ a.normal))
    return bool(
        tilt > _CONTRADICTION * np.hypot(a.normal_sigma, b.normal_sigma)
        or height > _CONTRADICTION * np.hypot(a.height_sigma, b.height_sigma)
    )


def camera_sigma(target: Target) -> float:
    """Return how well it is known where the camera belongs [m]: one standard deviation of place and normal together."""
    surface = target.surface
    standoff = np.linalg.norm(target.base_from_camera[:3, 3] - surface.point)
    return float(np.hypot(surface.height_sigma, standoff * surface.normal_sigma))
