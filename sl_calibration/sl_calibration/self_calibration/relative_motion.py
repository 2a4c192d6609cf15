"""Motion of the camera between two views of the same dots, from their essential matrix, and the robot's against it.

Dots are fixed in the scene while projector and scene stand still: each is a static point seen from several places.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration.views import Observations
from sl_common import transforms

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

LEAST_COMMON = 15
"""Dots that two views must share."""

_MOST_PAIRS = 150
_MOST_DOTS = 500
_PLANE_DRAWS = 100
_THRESHOLD = 1.5  # [px] of the RANSAC, generous: it only has to tell wrong codes from right ones.


@dataclass(frozen=True, eq=False)
class PairRotations:
    """Rotations between pairs of views.

    Attributes:
        first: (P,) index of the first view.
        second: (P,) index of the second view.
        camera: (P, 3, 3) camera_first_from_camera_second, from the images.
        flange: (P, 3, 3) flange_first_from_flange_second, from the robot.
        support: (P,) share of the common dots that agree with the camera's motion.
        poses: (V, 3, 3) base_from_flange rotations of all views, from the robot.
    """

    first: IntArray
    second: IntArray
    camera: Array
    flange: Array
    support: Array
    poses: Array

    def angle_mismatch(self) -> Array:
        """Return (P,) the difference of camera and flange rotation angles [rad]: zero for any hand-eye transform."""
        return np.abs(transforms.rotation_angle(self.camera) - transforms.rotation_angle(self.flange))


def index_table(observations: Observations) -> IntArray:
    """Return (V, K) the index of the observation of each dot in each view, -1 where it was not seen."""
    table = np.full((len(observations.names), len(observations.dots)), -1, dtype=np.int64)
    table[observations.view, observations.point] = np.arange(len(observations.view))
    return table


def pair_rotations(observations: Observations, normalised: Array, focal: float) -> PairRotations:
    """Estimate the camera's rotation between pairs of views.

    Args:
        observations: M observations.
        normalised: (M, 2) ideal normalised coordinates of the observations.
        focal: Focal length of the camera [px], the scale of the outlier threshold.
    """
    table = index_table(observations)
    seen = table >= 0
    common = seen.astype(np.int64) @ seen.T.astype(np.int64)
    first, second = np.triu_indices(len(table), 1)
    shared = common[first, second]
    order = np.argsort(-np.minimum(shared, _MOST_DOTS), kind="stable")
    order = order[shared[order] >= LEAST_COMMON]
    if len(order) > _MOST_PAIRS:
        # Keep every view's best pairs rather than the best pairs overall.
        order = order[np.linspace(0, len(order) - 1, _MOST_PAIRS).astype(int)]
    flange = observations.base_from_flange[:, :3, :3]
    found: list[tuple[int, int, Array, float]] = []
    for i, j in zip(first[order], second[order], strict=True):
        both = np.flatnonzero(seen[i] & seen[j])
        both = both[np.linspace(0, len(both) - 1, min(len(both), _MOST_DOTS)).astype(int)]
        flange_angle = float(transforms.rotation_angle(flange[i].T @ flange[j]))
        estimate = _relative_rotation(normalised[table[i, both]], normalised[table[j, both]], focal, flange_angle)
        if estimate is not None:
            found.append((int(i), int(j), *estimate))
    a = np.array([f[0] for f in found], dtype=np.int64)
    b = np.array([f[1] for f in found], dtype=np.int64)
    return PairRotations(
        first=a,
        second=b,
        camera=np.array([f[2] for f in found]).reshape(-1, 3, 3),
        flange=np.swapaxes(flange[a], -1, -2) @ flange[b],
        support=np.array([f[3] for f in found]),
        poses=flange,
    )


def _relative_rotation(a: Array, b: Array, focal: float, flange_angle: float) -> tuple[Array, float] | None:
    """Return camera_a_from_camera_b's rotation and the share of dots that agree, or None.

    Dots on a plane allow two rotations; then the one whose angle is nearer to the flange's is taken.
    """
    rotation, error = _pure_rotation(a, b)
    agree = error * focal < _THRESHOLD
    if agree.mean() > 0.8:  # hardly any parallax: the essential matrix would be arbitrary
        return _pure_rotation(a[agree], b[agree])[0], float(agree.mean())
    matrix = np.diag([focal, focal, 1.0])
    flat = _plane_rotations(a, b, focal)
    if flat is not None:
        rotations, share = flat
        angles = transforms.rotation_angle(rotations)
        return rotations[int(np.argmin(np.abs(angles - flange_angle)))], share
    essential, mask = cv2.findEssentialMat(
        b * focal, a * focal, matrix, method=cv2.USAC_MAGSAC, prob=0.9999, threshold=_THRESHOLD
    )
    if essential is None or essential.shape != (3, 3):
        return None
    _, rotation, _, _ = cv2.recoverPose(essential, b * focal, a * focal, matrix, mask=mask.copy())
    return rotation, float(mask.mean())


def _plane_rotations(a: Array, b: Array, focal: float) -> tuple[Array, float] | None:
    """Return the rotations (1 or 2, 3, 3) that a homography allows and its share of dots; None: a scene with depth."""
    # Only planes count, of which most draws are right: a few do.
    homography, mask = cv2.findHomography(b, a, cv2.RANSAC, _THRESHOLD / focal, maxIters=_PLANE_DRAWS, confidence=0.999)
    if homography is None or mask.mean() < 0.8:
        return None
    rays = np.column_stack([b, np.ones(len(b))])[mask.ravel() > 0]
    _, rotations, _, normals = cv2.decomposeHomographyMat(homography, np.eye(3))
    # The plane lies in front of the camera: its normal makes an acute angle with every ray. Twins differ in sign only.
    facing = [(rays @ n).min() * (rays @ n).max() > 0 and (rays @ n).mean() > 0 for n in normals]
    kept = [r for r, f in zip(rotations, facing, strict=True) if f]
    return (np.array(kept), float(mask.mean())) if kept else None


def _pure_rotation(a: Array, b: Array) -> tuple[Array, Array]:
    """Return the rotation R with ray_a = R ray_b in the least-squares sense and the errors (N,) [rad]."""
    rays = [np.column_stack([x, np.ones(len(x))]) for x in (a, b)]
    rays = [r / np.linalg.norm(r, axis=-1, keepdims=True) for r in rays]
    rotation = fit_rotation(rays[0], rays[1])
    return rotation, np.linalg.norm(rays[0] - rays[1] @ rotation.T, axis=-1)


def fit_rotation(a: Array, b: Array, weights: Array | None = None) -> Array:
    """Return the rotation R (3, 3) that minimises the sum of |a - R b|^2 over vectors (N, 3) (Kabsch)."""
    w = np.ones(len(a)) if weights is None else weights
    u, _, vt = np.linalg.svd((a * w[:, None]).T @ b)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
