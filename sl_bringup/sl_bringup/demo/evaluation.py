"""How good it was, against the cell's truth: nothing here is known to any node."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sl_bringup.demo.record import Cloud, Record
from sl_common import transforms
from sl_common.ros.stamps import to_ns
from sl_msgs.msg import Correspondences
from sl_sim.cell import Cell

Array = NDArray[np.float64]

_WRONG_DOT = 3.0
"""A dot farther than this from where the spot of its row and column is seen [px] is wrong; the pitch is about ten."""
_NORMAL_RADIUS = 0.025
"""The true surface's normal is taken over this radius [m], so that a pore does not count as its direction."""


@dataclass(frozen=True)
class PointErrors:
    """Distances of measured points from the true spots, and the component along the true normal.

    Attributes:
        count: Points compared.
        median: Of the distances [m].
        p95: Their 95th percentile [m].
        median_normal: Median of the absolute distance from the surface [m].
    """

    count: int
    median: float
    p95: float
    median_normal: float


@dataclass(frozen=True)
class DotErrors:
    """Decoded dots against what the camera truly saw.

    Attributes:
        count: Dots compared.
        wrong: Share of them with a wrong row or column [0..1].
        median_px: Median distance from the true image of their spots [px].
    """

    count: int
    wrong: float
    median_px: float


@dataclass(frozen=True)
class PoseErrors:
    """The arm's end pose.

    Attributes:
        position: True camera position from the commanded one [m].
        orientation: True camera orientation from the commanded one [rad].
        standoff: Distance to the true surface along the optical axis minus the one asked for [m].
        tilt: Angle between optical axis and true surface normal [rad].
    """

    position: float
    orientation: float
    standoff: float
    tilt: float


def point_errors(cell: Cell, centers: Array, clouds: Sequence[Cloud], record: Record, most: int = 12) -> PointErrors:
    """Compare clouds, at most ``most`` of them evenly over time, with the true spots.

    Args:
        cell: The true cell.
        centers: (rows, cols, 2) spot centres of the pattern [projector px].
        clouds: In the base frame.
        record: For the object's pose at each stamp.
        most: Clouds to compare.
    """
    distances, heights = [], []
    for cloud in _spread(clouds, most):
        spots, normals = cell.spots_in_base(
            centers[cloud.row, cloud.col], base_from_object=_at(record.object_poses, cloud.stamp)
        )
        offset = cloud.points - spots
        known = np.isfinite(offset).all(axis=1)
        distances.append(np.linalg.norm(offset[known], axis=1))
        heights.append(np.abs(np.sum(offset[known] * normals[known], axis=1)))
    distance = np.concatenate(distances) if distances else np.zeros(0)
    if distance.size == 0:
        return PointErrors(0, np.nan, np.nan, np.nan)
    return PointErrors(
        distance.size,
        float(np.median(distance)),
        float(np.quantile(distance, 0.95)),
        float(np.median(np.concatenate(heights))),
    )


def dot_errors(
    cell: Cell, centers: Array, images: Sequence[Correspondences], record: Record, most: int = 12
) -> DotErrors:
    """Compare decoded dots with the true images of their spots; arguments as :func:`point_errors`."""
    distances = []
    for message in _spread([m for m in images if to_ns(m.header.stamp) in record.camera_poses], most):
        stamp = to_ns(message.header.stamp)
        row, col = np.array(message.row, dtype=np.int64), np.array(message.col, dtype=np.int64)
        spots, _ = cell.spots_in_base(centers[row, col], base_from_object=_at(record.object_poses, stamp))
        seen = cell.camera.project(transforms.apply(transforms.inverse(record.camera_poses[stamp]), spots))
        pixels = np.stack([message.camera_u, message.camera_v], axis=-1)
        distance = np.linalg.norm(pixels - seen, axis=1)
        distances.append(np.where(np.isfinite(distance), distance, np.inf))  # the spot falls on nothing: a wrong code
    distance = np.concatenate(distances) if distances else np.zeros(0)
    if distance.size == 0:
        return DotErrors(0, np.nan, np.nan)
    return DotErrors(distance.size, float(np.mean(distance > _WRONG_DOT)), float(np.median(distance)))


def pose_errors(
    cell: Cell, commanded: Array, true: Array, standoff: float, base_from_object: Array | None = None
) -> PoseErrors:
    """Judge the true camera pose (4, 4) by the commanded one (4, 4) and by the true surface before the camera.

    Raises nothing: where the optical axis meets no surface, standoff and tilt are NaN.
    """
    difference = transforms.difference(commanded, true)
    distance, normal = surface_ahead(cell, true, base_from_object)
    axis = true[:3, 2]
    return PoseErrors(
        position=float(np.linalg.norm(difference[:3])),
        orientation=float(np.linalg.norm(difference[3:])),
        standoff=distance - standoff,
        tilt=float(np.arctan2(np.linalg.norm(np.cross(axis, normal)), -axis @ normal)),
    )


def surface_ahead(cell: Cell, base_from_camera: Array, base_from_object: Array | None = None) -> tuple[float, Array]:
    """Return the distance [m] to the true surface along the optical axis and the surface's unit normal (3,) there.

    The normal is that of a quadric fitted to the true surface within :data:`_NORMAL_RADIUS` around the point; what
    lies behind an edge does not count.
    """
    origin, axes = base_from_camera[:3, 3], base_from_camera[:3, :3]
    hit, _ = cell.surface_along_rays(origin, axes[None, :, 2], base_from_object=base_from_object)
    distance = float(np.linalg.norm(hit[0] - origin))
    if not np.isfinite(distance):
        return np.nan, np.full(3, np.nan)
    s = np.linspace(-1, 1, 41) * _NORMAL_RADIUS / distance
    x, y = (a.ravel() for a in np.meshgrid(s, s))
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ axes.T
    points, _ = cell.surface_along_rays(origin, rays, base_from_object=base_from_object)
    local = (points - hit[0]) @ axes  # camera axes at the hit
    near = np.isfinite(local).all(axis=1) & (np.linalg.norm(local, axis=1) <= _NORMAL_RADIUS)
    u, v, w = local[near].T / _NORMAL_RADIUS
    design = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
    coefficients = _robust_solution(design, w)
    normal = axes @ np.array([coefficients[1], coefficients[2], -1.0])
    return distance, normal / np.linalg.norm(normal)


def _robust_solution(design: Array, values: Array) -> Array:
    """Return the solution (6,) of least absolute deviations, by reweighting: it keeps to the middle's surface."""
    weight = np.exp(-4.0 * (design[:, 1] ** 2 + design[:, 2] ** 2))
    solution: Array = np.zeros(design.shape[1])
    w = weight
    for _ in range(50):
        root = np.sqrt(w)
        solution = np.asarray(np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0], dtype=np.float64)
        w = weight / np.maximum(np.abs(values - design @ solution), 1e-5)
    return solution


def _at(poses: dict[int, Array], stamp: int) -> Array | None:
    """Return the pose at the stamp, or the nearest one; None where there are none."""
    if stamp in poses:
        return poses[stamp]
    return poses[min(poses, key=lambda t: abs(t - stamp))] if poses else None


def _spread(items: Sequence, most: int) -> list:
    if len(items) <= most:
        return list(items)
    return [items[i] for i in np.linspace(0, len(items) - 1, most).round().astype(int)]
