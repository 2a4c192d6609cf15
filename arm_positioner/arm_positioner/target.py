"""Where the camera should be: in front of the object, at a stand-off along its surface normal.

"Using the 3D point cloud, we calculate a target point for the robot to move to, just in front of the object" (the
paper, section III.B). All in the robot's base frame.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_positioner import segmentation
from arm_positioner.common_error import common_covariance
from arm_positioner.errors import InvalidGoalError, ObjectGoneError, TargetError
from arm_positioner.places import clear_patch, other_patches
from arm_positioner.surface import FitOptions, SurfacePatch, fit_patch
from sl_common import transforms

Array = NDArray[np.float64]

_HIDDEN = 2.5
"""Distance of a place from the nearest dot from which on it is not seen, in units of the points' spacing."""


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
    projector: Array | None = None,
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
        projector: (3,) its position [m], by which the uncertainty allows for rays that meet at a small angle.
        previous: (3,) surface point chosen before [m]: the same object is taken again.
        anchor: (3,) position [m] to which the target's surface point stays next, which has to be seen; None: as
            ``offset`` says.
        offset: (3,) of the target's surface point from the object's middle [m]; None: as near the middle as the normal
            is clear.

    Raises TargetError, with the numbers, where there is no object or its surface fits too poorly.
    """
    options = options or TargetOptions()
    found = _find_object(points, base_from_camera, confidence, row, col, options, previous)
    viewpoint = base_from_camera[:3, 3]
    if anchor is not None:
        _require_seen(found, anchor)
    elif offset is not None:
        anchor = found.middle + offset
    if anchor is None:
        surface = clear_patch(*found.patch(viewpoint), fit=options.fit, clear=options.clear_normal_sigma)
    else:
        centre = found.points[np.argmin(np.linalg.norm(found.points - anchor, axis=1))]
        surface = fit_patch(found.points, found.weights, centre, viewpoint, found.spacing, options=options.fit)
    return _target(surface, found, base_from_camera, projector, options)


def other_targets(
    points: ArrayLike,
    base_from_camera: Array,
    *,
    confidence: ArrayLike | None = None,
    row: ArrayLike | None = None,
    col: ArrayLike | None = None,
    options: TargetOptions | None = None,
    projector: Array | None = None,
    previous: Array | None = None,
) -> list[Target]:
    """Return targets in front of other places of the same object, for one that the arm cannot go to, the best first.

    See :func:`find_target` for the arguments, and :func:`.places.other_patches` for what is best.
    """
    options = options or TargetOptions()
    found = _find_object(points, base_from_camera, confidence, row, col, options, previous)
    patches = other_patches(
        *found.patch(base_from_camera[:3, 3]),
        fit=options.fit,
        clear=options.clear_normal_sigma,
        standoff=options.standoff,
    )
    return [_target(surface, found, base_from_camera, projector, options) for surface in patches]


@dataclass(frozen=True, eq=False)
class _Object:
    """The points (N, 3) of the object [m], their weights (N,), their spacing [m] and their median (3,) [m]."""

    points: Array
    weights: Array
    spacing: float
    middle: Array

    def patch(self, viewpoint: Array) -> tuple[Array, Array, Array, float]:
        """Return what a surface is fitted to."""
        return self.points, self.weights, viewpoint, self.spacing


def _find_object(
    points: ArrayLike,
    base_from_camera: Array,
    confidence: ArrayLike | None,
    row: ArrayLike | None,
    col: ArrayLike | None,
    options: TargetOptions,
    previous: Array | None,
) -> _Object:
    """Return the nearest coherent patch of a cloud, or the one at ``previous``; see :func:`find_target`."""
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
    labels = segmentation.components(xyz, rows, cols)
    chosen = segmentation.nearest_component(
        xyz, labels, base_from_camera[:3, 3], min_points=options.min_object_points, previous=previous
    )
    if chosen.size == 0:
        raise TargetError(
            f"no coherent object: the largest of {labels.max() + 1} patches has {np.bincount(labels).max()} points, "
            f"at least {options.min_object_points} are needed"
        )
    if previous is not None:
        _require_near(xyz[chosen], previous, options.max_jump)
    found = xyz[chosen]
    return _Object(found, weight[chosen], segmentation.spacing(found), np.median(found, axis=0))


def _target(
    surface: SurfacePatch, found: _Object, base_from_camera: Array, projector: Array | None, options: TargetOptions
) -> Target:
    """Return the target in front of a piece of surface, its uncertainty with that of the triangulation."""
    if projector is not None:
        common = common_covariance(
            surface.point,
            surface.normal,
            surface.tangents,
            base_from_camera[:3, 3],
            projector,
            options.fit.place_sigma,
        )
        surface = replace(surface, covariance=surface.covariance + common)
    pose = facing_pose(surface.point, surface.normal, base_from_camera, options.standoff, options.roll)
    return Target(pose, surface, len(found.points), found.middle)


def _require_seen(found: _Object, anchor: Array) -> None:
    """Raise TargetError where no dot of the object is near a place of it: the camera may stand in the light."""
    distance, limit = float(np.linalg.norm(found.points - anchor, axis=1).min()), _HIDDEN * found.spacing
    if distance > limit:
        raise TargetError(
            f"the place is not seen: the nearest dot of the object is {1e3 * distance:.0f} mm from it, limit"
            f" {1e3 * limit:.0f} mm; it is in the shadow of the camera, or the object has moved"
        )


def _require_near(points: Array, previous: Array, limit: float) -> None:
    """Raise ObjectGoneError where no point of a patch (N, 3) is near where the object was."""
    distance = float(np.linalg.norm(points - previous, axis=1).min())
    if distance > limit:
        raise ObjectGoneError(
            f"the object is gone: the nearest patch is {1e3 * distance:.0f} mm from where it was seen before, limit "
            f"{1e3 * limit:.0f} mm"
        )


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
