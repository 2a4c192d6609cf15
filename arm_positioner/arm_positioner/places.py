"""Which place of an object to look at: where the surface normal is clear, as near the object's middle as may be."""

import numpy as np
from numpy.typing import NDArray

from arm_positioner.errors import TargetError
from arm_positioner.surface import FitOptions, SurfacePatch, fit_patch

Array = NDArray[np.float64]

_WHOLE = 0.95
"""Share of the points around a place that have to fit one surface; below, a crease or an edge is near."""
_OBLIQUE = 0.8
"""Angle between normal and line of sight up to which a place faces the camera [rad]."""
_PER_OBLIQUENESS = 0.01
"""What an angle past that weighs against the uncertainty of the normal [1]."""
_PLACES = 16
"""Places on the object that are looked at for a clear normal."""
_APART = 2.5
"""How far they are apart at least, in units of the points' spacing."""
_SPREAD = 0.35
"""How far they are apart where all of the object is to be covered, as a share of the extent they lie in."""
_INNER = 0.6
"""How far out they lie at most, as a share of the object's extent from its middle."""
_NEARLY = 1.5
"""How much more doubtful than the best place another one may be that is easier to reach."""


def clear_patch(
    points: Array, weights: Array, viewpoint: Array, spacing: float, *, fit: FitOptions, clear: float
) -> SurfacePatch:
    """Return the piece of surface nearest the middle of the object on which the normal is clear: known well, free of
    creases, towards the camera; the clearest where there is none.

    Args:
        points: (N, 3) of the object [m].
        weights: (N,) in 0..1.
        viewpoint: (3,) the camera's position [m].
        spacing: Typical distance between neighbouring points [m].
        fit: When a fit is good enough at all.
        clear: Standard deviation of the normal up to which a place is as good as any [rad].

    Raises TargetError with the reason at the middle where no fit is good enough.
    """
    refused: TargetError | None = None
    best: SurfacePatch | None = None
    least = (True, np.inf)
    for centre in _places(points, _APART * spacing):
        try:
            patch = fit_patch(points, weights, centre, viewpoint, spacing, options=fit)
        except TargetError as error:
            refused = refused or error
            continue
        rank = (patch.share < _WHOLE, _doubt(patch, viewpoint))
        if best is None or rank < least:
            best, least = patch, rank
        if least <= (False, clear):
            break
    if best is None:
        assert refused is not None
        raise refused
    return best


def other_patches(
    points: Array, weights: Array, viewpoint: Array, spacing: float, *, fit: FitOptions, clear: float, standoff: float
) -> list[SurfacePatch]:
    """Return pieces of surface all over the object, for a camera at ``standoff`` [m] that cannot go to the best one.

    Those whose normal is clear, or nearly as well known as the best of them, come first, near a crease or not; among
    them those that the camera has the shortest way to, as the arm is sure to reach where it is. Arguments as
    :func:`clear_patch`.
    """
    found: list[tuple[float, SurfacePatch]] = []
    for centre in _places(points, max(_APART * spacing, _SPREAD * _reach(points))):
        try:
            patch = fit_patch(points, weights, centre, viewpoint, spacing, options=fit)
        except TargetError:
            continue
        found.append((_doubt(patch, viewpoint), patch))
    limit = max(_NEARLY * min((doubt for doubt, _ in found), default=0.0), 0.5 * clear)

    def order(entry: tuple[float, SurfacePatch]) -> tuple[bool, float]:
        doubt, patch = entry
        return doubt > limit, float(np.linalg.norm(patch.point + standoff * patch.normal - viewpoint))

    return [patch for _, patch in sorted(found, key=order)]


def _doubt(patch: SurfacePatch, viewpoint: Array) -> float:
    """Return the uncertainty of a place's normal, more where it is oblique."""
    return patch.normal_sigma + _PER_OBLIQUENESS * max(patch.angle_to(viewpoint) - _OBLIQUE, 0.0)


def _reach(points: Array) -> float:
    """Return the distance from an object's middle up to which its points (N, 3) are places to aim at [m]."""
    distance = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    return _INNER * float(np.quantile(distance, 0.9))


def _places(points: Array, apart: float) -> list[Array]:
    """Return points of an object (N, 3) to aim at, the one in the middle first, each ``apart`` [m] from the others."""
    distance = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    inner = distance <= _reach(points)
    inner[np.argmin(distance)] = True
    chosen: list[Array] = []
    for i in np.argsort(distance, kind="stable")[: np.count_nonzero(inner)]:
        if all(np.linalg.norm(points[i] - other) > apart for other in chosen):
            chosen.append(points[i])
        if len(chosen) == _PLACES:
            break
    return chosen
