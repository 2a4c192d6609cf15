"""Do the flange's motion and the images belong together, and is the motion rich enough? The answers name views."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration.errors import DegenerateMotionError, InconsistentPosesError, TooFewViewsError
from sl_calibration.self_calibration.initialise import conjugation_error, hand_eye_rotation
from sl_calibration.self_calibration.relative_motion import LEAST_COMMON, PairRotations
from sl_common import transforms
from sl_common.errors import StructuredLightError

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

LEAST_VIEWS = 3
LEAST_ROTATION = np.radians(1.0)
"""Below this the rotation about a second axis does not show the hand-eye translation."""

_AGREEMENT = np.radians(1.0)


@dataclass(frozen=True)
class MotionSpread:
    """How much a set of flange poses turns.

    Attributes:
        first: RMS rotation between views about the main axis [rad].
        second: RMS rotation about axes across it [rad].
        axes: Angle between the two best separated axes of rotation [rad].
        axis: Main axis of rotation in the base frame.
        translation: Largest distance between two flange positions [m].
    """

    first: float
    second: float
    axes: float
    axis: tuple[float, float, float]
    translation: float


def motion_spread(poses: Array) -> MotionSpread:
    """Measure the rotations between all pairs of flange poses (V, 4, 4)."""
    i, j = np.triu_indices(len(poses), 1)
    if len(i) == 0:
        return MotionSpread(0.0, 0.0, 0.0, (0.0, 0.0, 1.0), 0.0)
    turns = transforms.rotation_log(poses[j, :3, :3] @ np.swapaxes(poses[i, :3, :3], -1, -2))
    _, s, vt = np.linalg.svd(turns, full_matrices=False)
    s = s / np.sqrt(len(turns))
    length = np.linalg.norm(turns, axis=-1)
    large = turns[length > LEAST_ROTATION] / length[length > LEAST_ROTATION, None]
    cosine = np.abs(large @ large.T) if len(large) else np.ones((1, 1))
    distance = np.linalg.norm(poses[i, :3, 3] - poses[j, :3, 3], axis=-1)
    return MotionSpread(
        first=float(s[0]),
        second=float(s[1]) if len(s) > 1 else 0.0,
        axes=float(np.arccos(np.clip(cosine.min(), 0, 1))),
        axis=(float(vt[0, 0]), float(vt[0, 1]), float(vt[0, 2])),
        translation=float(distance.max()),
    )


def check_motion(poses: Array) -> MotionSpread:
    """Return the spread of a motion; raises TooFewViewsError or DegenerateMotionError with the motion to add."""
    if len(poses) < LEAST_VIEWS:
        raise TooFewViewsError(
            f"{len(poses)} usable views, at least {LEAST_VIEWS} are needed and 10 advised: add views turned by 20 deg"
            " or more about two different axes"
        )
    spread = motion_spread(poses)
    if spread.first < LEAST_ROTATION:
        raise DegenerateMotionError(
            f"pure translation: the flange turns by {np.degrees(spread.first):.2f} deg only, so the hand-eye transform"
            " is not determined; add views turned by 20 deg or more about two different axes"
        )
    if spread.second < LEAST_ROTATION:
        axis = " ".join(f"{x:.2f}" for x in spread.axis)
        raise DegenerateMotionError(
            f"one axis of rotation: all views are turned about the base direction ({axis}) and by"
            f" {np.degrees(spread.second):.2f} deg across it, so the hand-eye translation along it is not determined;"
            " add views turned by 20 deg or more about an axis across it"
        )
    if spread.translation < 5e-3:
        raise DegenerateMotionError(
            f"the flange moves by {1e3 * spread.translation:.1f} mm only, so the scale is not determined; add views"
            " from places some 0.1 m apart"
        )
    return spread


def check_pairs(pairs: PairRotations, names: Sequence[str]) -> tuple[Array, BoolArray]:
    """Return the hand-eye rotation (3, 3) and the views (V,) whose flange rotations fit the images.

    Raises InconsistentPosesError when hardly any do, with the most likely reason, and TooFewViewsError when the views
    do not share enough dots.
    """
    count = len(names)
    seen = np.zeros(count, dtype=bool)
    seen[pairs.first] = seen[pairs.second] = True
    if seen.sum() < LEAST_VIEWS:
        raise TooFewViewsError(
            f"only {int(seen.sum())} of {count} views share enough dots with another: let the views overlap more"
        )
    try:
        rotation, agree = hand_eye_rotation(pairs)
    except InconsistentPosesError:
        raise InconsistentPosesError(_reason(pairs, names, np.zeros(count, dtype=bool))) from None
    good = _consistent_views(pairs, agree, count) & seen
    if good.sum() < LEAST_VIEWS:
        raise InconsistentPosesError(_reason(pairs, names, good))
    return rotation, good


def check_most(pairs: PairRotations, names: Sequence[str], good: BoolArray) -> None:
    """Raise InconsistentPosesError with the most likely reason where less than 60 % of the views are ``good`` (V,)."""
    if good.sum() < max(LEAST_VIEWS, 0.6 * len(names)):
        raise InconsistentPosesError(_reason(pairs, names, good))


def _consistent_views(pairs: PairRotations, agree: BoolArray, count: int) -> BoolArray:
    """Drop the view with the largest share of disagreeing pairs until every one left agrees with most others."""
    good = np.ones(count, dtype=bool)
    for _ in range(count):
        used = good[pairs.first] & good[pairs.second]
        total = np.bincount(pairs.first[used], minlength=count) + np.bincount(pairs.second[used], minlength=count)
        right = used & agree
        agreeing = np.bincount(pairs.first[right], minlength=count) + np.bincount(pairs.second[right], minlength=count)
        share = np.where(good & (total > 0), agreeing / np.maximum(total, 1), np.where(good, 0.0, np.inf))
        worst = int(np.argmin(share))
        if share[worst] >= 0.6:
            break
        good[worst] = False
    return good


def describe_outliers(pairs: PairRotations, names: Sequence[str], good: BoolArray) -> list[str]:
    """Return a sentence for each view whose pose does not fit its image, or for two that were swapped."""
    bad = [int(i) for i in np.flatnonzero(~good)]
    sentences = []
    for i in list(bad):
        for j in [k for k in bad if k > i]:
            if i in bad and j in bad and _mismatch(pairs, _swapped(len(names), i, j), good) < _AGREEMENT:
                sentences.append(f"the poses or images of {names[i]} and {names[j]} are swapped")
                bad.remove(i)
                bad.remove(j)
    for i in bad:
        errors = np.degrees(pairs.angle_mismatch()[(pairs.first == i) | (pairs.second == i)])
        how = f", rotation off by {np.median(errors):.1f} deg" if len(errors) else ""
        sentences.append(f"the pose of {names[i]} does not fit its image{how}")
    return sentences


def _swapped(count: int, i: int, j: int) -> NDArray[np.int64]:
    order = np.arange(count)
    order[[i, j]] = j, i
    return order


def _mismatch(pairs: PairRotations, order: NDArray[np.int64], good: BoolArray) -> float:
    """Return the upper quartile of the angle mismatch [rad] of the pairs that a reordering of the poses touches."""
    flange = _flange_angles(pairs, len(order))
    moved = order != np.arange(len(order))
    chosen = (moved[pairs.first] & good[pairs.second]) | (moved[pairs.second] & good[pairs.first])
    if not chosen.any():
        chosen = np.ones(len(pairs.first), dtype=bool)
    a, b = order[pairs.first[chosen]], order[pairs.second[chosen]]
    difference = np.abs(flange[a, b] - transforms.rotation_angle(pairs.camera[chosen]))
    known = np.isfinite(difference)
    return float(np.percentile(difference[known], 75)) if known.sum() > 2 else np.inf


def _flange_angles(pairs: PairRotations, count: int) -> Array:
    """Return (V, V) rotation angles of the flange between the views of the pairs; NaN where no pair exists."""
    table = np.full((count, count), np.nan)
    table[pairs.first, pairs.second] = table[pairs.second, pairs.first] = transforms.rotation_angle(pairs.flange)
    return table


def _reason(pairs: PairRotations, names: Sequence[str], good: BoolArray) -> str:
    """Guess why poses and images disagree; returns a sentence with the numbers."""
    count = len(names)
    mismatch = pairs.angle_mismatch()
    fits = int((mismatch < _AGREEMENT).sum())
    facts = f"{fits} of {len(mismatch)} pairs of views turn by the same angle as the flange"
    if len(mismatch) < 2 * count and fits >= 0.5 * len(mismatch):
        return (
            f"{facts}, and only {len(mismatch)} pairs of {count} views share {LEAST_COMMON} dots and more: let the"
            " views overlap more, or bring more dots into view"
        )
    for order, what in (
        (np.arange(count)[::-1], "in reverse order"),
        (np.roll(np.arange(count), 1), "shifted by one image"),
        (np.roll(np.arange(count), -1), "shifted by one image"),
    ):
        if _mismatch(pairs, order, np.ones(count, dtype=bool)) < _AGREEMENT:
            return f"the poses are {what}: {facts}; pair each image with the pose at its own stamp"
    if fits > 0.8 * len(mismatch):
        if _inverse_fits(pairs):
            return "the poses look like flange_from_base: give base_from_flange, the inverse"
        return f"{facts}, but about axes that no hand-eye transform explains: rotations in another convention"
    swapped = [s for s in describe_outliers(pairs, names, good) if "swapped" in s] if good.any() else []
    if swapped:
        return f"{'; '.join(swapped)}: {facts}"
    return (
        f"the poses do not belong to these images: only {facts}; they are shuffled, from another motion, or the scene"
        " or the projector moved"
    )


def _inverse_fits(pairs: PairRotations) -> bool:
    inverse = replace(pairs, flange=pairs.poses[pairs.first] @ np.swapaxes(pairs.poses[pairs.second], -1, -2))
    try:
        rotation, _ = hand_eye_rotation(inverse)
    except StructuredLightError:
        return False
    return float((conjugation_error(inverse, rotation) < _AGREEMENT).mean()) > 0.8
