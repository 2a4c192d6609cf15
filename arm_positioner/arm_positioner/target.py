"""Where the camera should be: in front of the object, at a stand-off along its surface normal.

"Using the 3D point cloud, we calculate a target point for the robot to move to, just in front of the object" (the
paper, section III.B). All in the robot's base frame.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_positioner import segmentation
from arm_positioner.errors import InvalidGoalError, ObjectGoneError, TargetError
from arm_positioner.surface import FitOptions, SurfacePatch, fit_patch
from sl_common import transforms

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
_INNER = 0.6
"""How far out they lie at most, as a share of the object's extent from its middle."""


@dataclass(frozen=True, kw_only=True)
class TargetOptions:
    """How the target is chosen.

    Attributes:
        standoff: Distance of the camera from the surface along its normal [m].
        roll: Angle about the optical axis [rad], 0: the image is upright (its up is the base's z); None: the
            orientation that needs the least rotation of the camera.
        min_confidence: Points below it are ignored.
        min_object_points: Patches with fewer points are no objects.
        clear_normal_sigma: Standard deviation of the normal [rad] up to which a place on the object is as good as any.
        max_jump: Distance from where the object was seen before past which a patch is another object [m].
        fit: When the surface fit is good enough.
    """

    standoff: float = 0.3
    roll: float | None = None
    min_confidence: float = 0.0
    min_object_points: int = 20
    clear_normal_sigma: float = 0.005
    max_jump: float = 0.1
    fit: FitOptions = field(default_factory=FitOptions)


@dataclass(frozen=True, eq=False)
class Target:
    """A camera pose and the surface it looks at.

    Attributes:
        base_from_camera: (4, 4) wanted pose of the camera [m].
        surface: The surface it faces.
        object_points: Number of points of the object.
        middle: (3,) median of its points [m].
    """

    base_from_camera: Array
    surface: SurfacePatch
    object_points: int
    middle: Array


def find_target(
    points: ArrayLike,
    base_from_camera: Array,
    *,
    confidence: ArrayLike | None = None,
    row: ArrayLike | None = None,
    col: ArrayLike | None = None,
    options: TargetOptions | None = None,
    previous: Array | None = None,
    anchor: Array | None = None,
    offset: Array | None = None,
) -> Target:
    """Find the object in a cloud and the camera pose in front of it.

    Args:
        points: (N, 3) in the base frame [m]; points that are not finite are ignored.
        base_from_camera: (4, 4) present camera pose [m].
        confidence: (N,) in 0..1; None: all alike.
        row: (N,) pattern row of each point; None: neighbours by distance.
        col: (N,) pattern column of each point.
        options: How to choose.
        previous: (3,) surface point chosen before [m]: the same object is taken again.
        anchor: (3,) position [m] to which the target's surface point stays next; None: as ``offset`` says.
        offset: (3,) of the target's surface point from the object's middle [m]; None: as near the middle as the normal
            is clear.

    Raises TargetError, with the numbers, where there is no object or its surface fits too poorly.
    """
    options = options or TargetOptions()
    xyz = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    n = len(xyz)
    weight = np.ones(n) if confidence is None else np.asarray(confidence, dtype=np.float64)
    keep = np.isfinite(xyz).all(axis=1) & np.isfinite(weight) & (weight >= options.min_confidence)
    if np.count_nonzero(keep) < options.min_object_points:
        raise TargetError(
            f"{np.count_nonzero(keep)} usable points of {n} in the cloud, at least "
            f"{options.min_object_points} are needed"
        )
    xyz, weight = xyz[keep], weight[keep]
    rows = None if row is None else np.asarray(row)[keep]
    cols = None if col is None else np.asarray(col)[keep]
    viewpoint = base_from_camera[:3, 3]
    labels = segmentation.components(xyz, rows, cols)
    chosen = segmentation.nearest_component(
        xyz, labels, viewpoint, min_points=options.min_object_points, previous=previous
    )
    if previous is not None and chosen.size:
        _require_near(xyz[chosen], previous, options.max_jump)
    if chosen.size == 0:
        raise TargetError(
            f"no coherent object: the largest of {labels.max() + 1} patches has {np.bincount(labels).max()} points, "
            f"at least {options.min_object_points} are needed"
        )
    patch_points, patch_weight = xyz[chosen], weight[chosen]
    spacing = segmentation.spacing(patch_points)
    middle = np.median(patch_points, axis=0)
    if anchor is None and offset is not None:
        anchor = middle + offset
    if anchor is None:
        surface = _clear_patch(patch_points, patch_weight, viewpoint, spacing, options)
    else:
        centre = patch_points[np.argmin(np.linalg.norm(patch_points - anchor, axis=1))]
        surface = fit_patch(patch_points, patch_weight, centre, viewpoint, spacing, options=options.fit)
    pose = facing_pose(surface.point, surface.normal, base_from_camera, options.standoff, options.roll)
    return Target(pose, surface, len(chosen), middle)


def _require_near(points: Array, previous: Array, limit: float) -> None:
    """Raise ObjectGoneError where no point of a patch (N, 3) is near where the object was."""
    distance = float(np.linalg.norm(points - previous, axis=1).min())
    if distance > limit:
        raise ObjectGoneError(
            f"the object is gone: the nearest patch is {1e3 * distance:.0f} mm from where it was seen before, limit "
            f"{1e3 * limit:.0f} mm"
        )


def _clear_patch(
    points: Array, weights: Array, viewpoint: Array, spacing: float, options: TargetOptions
) -> SurfacePatch:
    """Return the piece of surface nearest the middle of the object on which the normal is clear: known well, free of
    creases, towards the camera; the clearest where there is none.

    Raises TargetError with the reason at the middle where no fit is good enough.
    """
    refused: TargetError | None = None
    best: SurfacePatch | None = None
    least = (True, np.inf)
    for centre in _places(points, spacing):
        try:
            patch = fit_patch(points, weights, centre, viewpoint, spacing, options=options.fit)
        except TargetError as error:
            refused = refused or error
            continue
        doubt = patch.normal_sigma + _PER_OBLIQUENESS * max(patch.angle_to(viewpoint) - _OBLIQUE, 0.0)
        rank = (patch.share < _WHOLE, doubt)
        if best is None or rank < least:
            best, least = patch, rank
        if least <= (False, options.clear_normal_sigma):
            break
    if best is None:
        assert refused is not None
        raise refused
    return best


def _places(points: Array, spacing: float) -> list[Array]:
    """Return points of an object (N, 3) to aim at, the one in the middle first, each some dots from the others."""
    distance = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    inner = distance <= _INNER * np.quantile(distance, 0.9)
    inner[np.argmin(distance)] = True
    chosen: list[Array] = []
    for i in np.argsort(distance, kind="stable")[: np.count_nonzero(inner)]:
        if all(np.linalg.norm(points[i] - other) > _APART * spacing for other in chosen):
            chosen.append(points[i])
        if len(chosen) == _PLACES:
            break
    return chosen


def facing_pose(
    point: ArrayLike, normal: ArrayLike, base_from_camera: Array, standoff: float, roll: float | None = None
) -> Array:
    """Return base_from_camera (4, 4) at ``standoff`` [m] before a surface point, optical axis against the normal.

    Args:
        point: (3,) on the surface [m].
        normal: (3,) outward unit normal.
        base_from_camera: (4, 4) present pose, from which the rotation is least when ``roll`` is None.
        standoff: Distance from the surface [m], positive.
        roll: Angle about the optical axis from the upright image [rad], or None.

    Raises InvalidGoalError for a stand-off that is not positive.
    """
    point, normal = np.asarray(point, dtype=np.float64), np.asarray(normal, dtype=np.float64)
    if not (np.isfinite(standoff) and standoff > 0):
        raise InvalidGoalError(f"standoff {standoff:g} m must be positive")
    position = point + standoff * normal
    if roll is not None:
        up = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
        upright = transforms.look_at(position, point, up)
        turn = transforms.make(transforms.rotation_exp((0.0, 0.0, roll)), np.zeros(3))
        return upright @ turn
    rotation = base_from_camera[:3, :3]
    return transforms.make(_least_rotation(rotation[:, 2], -normal) @ rotation, position)


def _least_rotation(a: Array, b: Array) -> Array:
    """Return the rotation (3, 3) of least angle from unit vector a to b; half a turn about any axis if opposite."""
    axis = np.cross(a, b)
    sine, cosine = float(np.linalg.norm(axis)), float(a @ b)
    if sine < 1e-12:
        if cosine > 0:
            return np.eye(3)
        axis = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        sine = 0.0
        return transforms.rotation_exp(np.pi * axis / np.linalg.norm(axis))
    return transforms.rotation_exp(np.arctan2(sine, cosine) * axis / sine)
