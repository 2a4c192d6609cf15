"""Where the camera should be: in front of the object, at a stand-off along its surface normal.

"Using the 3D point cloud, we calculate a target point for the robot to move to, just in front of the object" (the
paper, section III.B). All in the robot's base frame.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_positioner import segmentation
from arm_positioner.errors import InvalidGoalError, TargetError
from arm_positioner.surface import FitOptions, SurfacePatch, fit_patch
from sl_common import transforms

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class TargetOptions:
    """How the target is chosen.

    Attributes:
        standoff: Distance of the camera from the surface along its normal [m].
        roll: Angle about the optical axis [rad], 0: the image is upright (its up is the base's z); None: the
            orientation that needs the least rotation of the camera.
        min_confidence: Points below it are ignored.
        min_object_points: Patches with fewer points are no objects.
        fit: When the surface fit is good enough.
    """

    standoff: float = 0.3
    roll: float | None = None
    min_confidence: float = 0.0
    min_object_points: int = 20
    fit: FitOptions = field(default_factory=FitOptions)


@dataclass(frozen=True, eq=False)
class Target:
    """A camera pose and the surface it looks at.

    Attributes:
        base_from_camera: (4, 4) wanted pose of the camera [m].
        surface: The surface it faces.
        object_points: Number of points of the object.
    """

    base_from_camera: Array
    surface: SurfacePatch
    object_points: int


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
        anchor: (3,) position [m] to which the target's surface point stays next; None: the object's middle.

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
    if chosen.size == 0:
        raise TargetError(
            f"no coherent object: the largest of {labels.max() + 1} patches has {np.bincount(labels).max()} points, "
            f"at least {options.min_object_points} are needed"
        )
    patch_points, patch_weight = xyz[chosen], weight[chosen]
    middle = np.median(patch_points, axis=0) if anchor is None else np.asarray(anchor, dtype=np.float64)
    centre = patch_points[np.argmin(np.linalg.norm(patch_points - middle, axis=1))]
    surface = fit_patch(
        patch_points, patch_weight, centre, viewpoint, segmentation.spacing(patch_points), options=options.fit
    )
    pose = facing_pose(surface.point, surface.normal, base_from_camera, options.standoff, options.roll)
    return Target(pose, surface, len(chosen))


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
