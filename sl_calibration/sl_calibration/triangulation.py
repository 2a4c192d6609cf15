"""Triangulation of decoded dots between the camera and the projector (paper section III.B).

Every dot gives one homogeneous system of four equations, solved by its singular value decomposition, all dots at once.
Before that the pair is moved onto its epipolar plane by the smallest correction weighted with the noise of either side,
so that the two rays meet. Dots are refused, with the reason, for their distance from the epipolar line, for lying
behind the camera or the projector, and for rays too parallel to fix a depth.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]


class Rejection(IntEnum):
    """Why a dot gave no point; ``NONE`` is a good point."""

    NONE = 0
    NOT_FINITE = 1
    """The lens model cannot be inverted at the pixel, or a coordinate is not finite."""
    EPIPOLAR = 2
    """Farther from the epipolar line than allowed: a wrong code or a wrong calibration."""
    BEHIND = 3
    """Behind the camera or the projector (cheirality), or outside the allowed depths."""
    PARALLEL = 4
    """The rays of camera and projector are too parallel to fix a depth."""


@dataclass(frozen=True, kw_only=True)
class TriangulationOptions:
    """How to triangulate.

    Attributes:
        max_epipolar_distance: Largest distance of the dot from its epipolar line in the camera image [px].
        min_angle: Least angle between the rays of camera and projector [rad].
        min_depth: Least distance along the camera's optical axis [m].
        max_depth: Largest distance along the camera's optical axis [m].
        camera_sigma: Noise of a dot's centre in the camera image [px], relative to ``projector_sigma``.
        projector_sigma: Noise of a dot's centre in the projected image [px]; it is known, 0 is exact.
    """

    max_epipolar_distance: float = 2.0
    min_angle: float = np.radians(1.0)
    min_depth: float = 0.01
    max_depth: float = np.inf
    camera_sigma: float = 1.0
    projector_sigma: float = 0.0

    def __post_init__(self) -> None:
        if not self.max_epipolar_distance > 0:
            raise InvalidInputError(f"max_epipolar_distance must be positive, got {self.max_epipolar_distance:g} px")
        if not 0 <= self.min_depth < self.max_depth:
            raise InvalidInputError(
                f"depths {self.min_depth:g}..{self.max_depth:g} m: the least must be below the largest"
            )
        if self.camera_sigma < 0 or self.projector_sigma < 0 or self.camera_sigma + self.projector_sigma == 0:
            raise InvalidInputError(
                f"camera_sigma {self.camera_sigma:g} and projector_sigma {self.projector_sigma:g} px:"
                " none may be negative, one must be positive"
            )


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Points of one view, one entry per dot given.

    Attributes:
        points: (N, 3) float64 in the camera's optical frame [m]; NaN where rejected.
        rejection: (N,) uint8, :class:`Rejection`.
        epipolar_distance: (N,) float64, distance from the epipolar line in the camera image [px]; NaN where not finite.
    """

    points: Array
    rejection: NDArray[np.uint8]
    epipolar_distance: Array

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(N,) which dots gave a point."""
        return self.rejection == Rejection.NONE

    def counts(self) -> dict[str, int]:
        """Number of dots per reason, lower-case names of :class:`Rejection`; ``none`` are the good ones."""
        numbers = np.bincount(self.rejection, minlength=len(Rejection))
        return {reason.name.lower(): int(numbers[reason]) for reason in Rejection}


def camera_from_projector(
    base_from_flange: ArrayLike, flange_from_camera: ArrayLike, base_from_projector: ArrayLike
) -> Array:
    """Chain the three calibrated transforms (4, 4) [m] of paper fig. 5 into the extrinsics of one view."""
    base_from_camera = np.asarray(base_from_flange, dtype=np.float64) @ np.asarray(flange_from_camera, dtype=np.float64)
    return transforms.inverse(base_from_camera) @ np.asarray(base_from_projector, dtype=np.float64)


def essential_matrix(extrinsics: ArrayLike) -> Array:
    """Return E (3, 3) with x_camera^T E x_projector = 0 from camera_from_projector (4, 4)."""
    extrinsics = np.asarray(extrinsics, dtype=np.float64)
    return transforms.skew(extrinsics[:3, 3]) @ extrinsics[:3, :3]


def triangulate(
    camera: CameraModel,
    projector: CameraModel,
    extrinsics: ArrayLike,
    camera_pixels: ArrayLike,
    projector_pixels: ArrayLike,
    options: TriangulationOptions | None = None,
) -> Triangulation:
    """Triangulate dots (paper section III.B, "a homogeneous system of equations for every point, using an SVD").

    Args:
        camera: Camera model.
        projector: Projector model.
        extrinsics: camera_from_projector (4, 4) [m], see :func:`camera_from_projector`.
        camera_pixels: (N, 2) raw camera pixels.
        projector_pixels: (N, 2) projector pixels of the same dots.
        options: Limits and weights.

    Raises:
        InvalidInputError: arrays of different shape, extrinsics not rigid, or camera and projector at the same place.
    """
    options = options or TriangulationOptions()
    extrinsics = np.asarray(extrinsics, dtype=np.float64)
    camera_pixels = np.asarray(camera_pixels, dtype=np.float64).reshape(-1, 2)
    projector_pixels = np.asarray(projector_pixels, dtype=np.float64).reshape(-1, 2)
    if camera_pixels.shape != projector_pixels.shape:
        raise InvalidInputError(f"{len(camera_pixels)} camera pixels but {len(projector_pixels)} projector pixels")
    if not transforms.is_rigid(extrinsics, 1e-4):
        raise InvalidInputError(
            "camera_from_projector is not a rigid transform: check the calibration and the joint state"
        )
    baseline = float(np.linalg.norm(extrinsics[:3, 3]))
    if baseline < 1e-6:
        raise InvalidInputError(
            f"camera and projector are {baseline:g} m apart: no depth can be had, check the calibration"
        )

    points = np.full((len(camera_pixels), 3), np.nan)
    rejection = np.full(len(points), Rejection.NOT_FINITE, dtype=np.uint8)
    distance = np.full(len(points), np.nan)
    finite = np.flatnonzero(np.isfinite(camera_pixels).all(-1) & np.isfinite(projector_pixels).all(-1))
    x_camera, x_projector = camera.undistort(camera_pixels[finite]), projector.undistort(projector_pixels[finite])
    invertible = np.isfinite(x_camera).all(-1) & np.isfinite(x_projector).all(-1)
    finite, x_camera, x_projector = finite[invertible], x_camera[invertible], x_projector[invertible]
    if len(finite) == 0:
        return Triangulation(points, rejection, distance)

    essential = essential_matrix(extrinsics)
    distance[finite] = _epipolar_distance(essential, x_camera, x_projector, camera)
    # A dot far off its line is refused anyway, so only the near ones are worked out.
    near = distance[finite] <= options.max_epipolar_distance
    rejection[finite] = np.where(near, Rejection.NONE, Rejection.EPIPOLAR)
    used, x_camera, x_projector = finite[near], x_camera[near], x_projector[near]
    x_camera, x_projector = _meet(essential, x_camera, x_projector, camera, projector, options)
    in_camera, w = _homogeneous_svd(extrinsics, x_camera, x_projector)

    in_projector = transforms.apply(transforms.inverse(extrinsics), in_camera)
    depth = in_camera[:, 2]
    # (w == 0 is a point at infinity; the division left it not finite and the comparisons below are false for it.)
    ahead = (w != 0) & (depth > options.min_depth) & (depth < options.max_depth) & (in_projector[:, 2] > 0)
    rejection[used[~ahead]] = Rejection.BEHIND
    angle = _ray_angle(extrinsics, x_camera, x_projector)
    rejection[used[angle < options.min_angle]] = Rejection.PARALLEL
    good = rejection[used] == Rejection.NONE
    points[used[good]] = in_camera[good]
    return Triangulation(points, rejection, distance)


def _lines(matrix: Array, x: Array) -> Array:
    """Return the lines (N, 3) that ``matrix`` (3, 3) assigns to points (N, 2)."""
    return x @ matrix[:, :2].T + matrix[:, 2]


def _epipolar_distance(essential: Array, x_camera: Array, x_projector: Array, camera: CameraModel) -> Array:
    """Return distances (N,) [px] of camera points from their epipolar lines, in the scale of the image centre."""
    lines = _lines(essential, x_projector)
    error = (lines[:, :2] * x_camera).sum(-1) + lines[:, 2]
    slope = np.hypot(lines[:, 0] / camera.matrix[0, 0], lines[:, 1] / camera.matrix[1, 1])
    return np.abs(error) / np.maximum(slope, 1e-300)


def _meet(
    essential: Array,
    x_camera: Array,
    x_projector: Array,
    camera: CameraModel,
    projector: CameraModel,
    options: TriangulationOptions,
) -> tuple[Array, Array]:
    """Move pairs (N, 2), (N, 2) onto their epipolar planes by the weighted Sampson correction, twice.

    The first step is the optimum of the linearised constraint, the second leaves an error of fourth order.
    """
    camera_variance = (options.camera_sigma / np.diag(camera.matrix)[:2]) ** 2
    projector_variance = (options.projector_sigma / np.diag(projector.matrix)[:2]) ** 2
    moved_camera, moved_projector = x_camera, x_projector
    for _ in range(2):
        slope_camera = _lines(essential, moved_projector)[:, :2]
        slope_projector = _lines(essential.T, moved_camera)[:, :2]
        constant = (slope_camera * moved_camera).sum(-1) + _lines(essential, moved_projector)[:, 2]
        # Constraint linearised at the moved pair, written for the correction from the measured pair.
        error = constant + (slope_camera * (x_camera - moved_camera)).sum(-1)
        error += (slope_projector * (x_projector - moved_projector)).sum(-1)
        weight = (slope_camera**2 * camera_variance).sum(-1) + (slope_projector**2 * projector_variance).sum(-1)
        step = (error / np.maximum(weight, 1e-300))[:, None]
        moved_camera = x_camera - step * slope_camera * camera_variance
        moved_projector = x_projector - step * slope_projector * projector_variance
    return moved_camera, moved_projector


def _homogeneous_svd(extrinsics: Array, x_camera: Array, x_projector: Array) -> tuple[Array, Array]:
    """Solve A X = 0 for N points at once; returns points (N, 3) in the camera frame and their scale w (N,).

    A (N, 4, 4) holds x p3 - p1 and y p3 - p2 of camera [I | 0] and projector [R | t]^-1. Lengths are in units of the
    baseline, so that the rows and the unknown are balanced.
    """
    scale = float(np.linalg.norm(extrinsics[:3, 3]))
    projector_from_camera = transforms.inverse(extrinsics)[:3].copy()
    projector_from_camera[:, 3] /= scale
    system = np.empty((len(x_camera), 4, 4))
    system[:, :2] = x_camera[:, :, None] * np.eye(4)[2] - np.eye(4)[:2]
    system[:, 2:] = x_projector[:, :, None] * projector_from_camera[2] - projector_from_camera[:2]
    system /= np.linalg.norm(system, axis=-1, keepdims=True)
    solution = np.linalg.svd(system)[2][:, 3]
    w = solution[:, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        points = scale * solution[:, :3] / w[:, None]
    return points, w


def _ray_angle(extrinsics: Array, x_camera: Array, x_projector: Array) -> Array:
    """Return the angles (N,) [rad] between the rays of camera and projector."""
    ones = np.ones((len(x_camera), 1))
    a = np.hstack([x_camera, ones])
    b = np.hstack([x_projector, ones]) @ extrinsics[:3, :3].T
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(-1))
