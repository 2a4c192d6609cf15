"""A start for the bundle adjustment from nothing but observations, flange poses and the camera's intrinsics.

1. Rotations of the camera between views (essential matrices) against those of the flange give the hand-eye rotation.
2. With all camera orientations known, the hand-eye translation and all dots follow from one linear system, metric at
   once because the flange's positions are: the unknown scale of each pair never appears.
3. The dots in the base frame and their projector pixels give the projector by resection from several starts.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sl_calibration.self_calibration.errors import DegenerateSceneError, InconsistentPosesError, SelfCalibrationError
from sl_calibration.self_calibration.relative_motion import PairRotations, fit_rotation
from sl_calibration.self_calibration.views import Observations
from sl_common import transforms
from sl_common.errors import StructuredLightError

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_LARGEST_ANGLE = np.radians(170.0)  # beyond, the axis of a rotation flips with its noise
_AGREEMENT = np.radians(1.0)


def hand_eye_rotation(pairs: PairRotations, seed: int = 0) -> tuple[Array, BoolArray]:
    """Solve R_flange X = X R_camera for the hand-eye rotation, robustly.

    Rotation vectors of both sides differ by X alone: log(R_flange) = X log(R_camera).

    Returns:
        Rotation flange_from_camera (3, 3) and the pairs (P,) that agree within a degree.

    Raises:
        InconsistentPosesError: fewer than two pairs turn by the angle of the flange.
    """
    a, b = transforms.rotation_log(pairs.flange), transforms.rotation_log(pairs.camera)
    length = np.linalg.norm(b, axis=-1)
    usable = (pairs.angle_mismatch() < _AGREEMENT) & (length < _LARGEST_ANGLE)
    if usable.sum() < 2:
        raise InconsistentPosesError(
            f"{int(usable.sum())} of {len(a)} pairs of views turn by the same angle as the flange"
        )
    candidates = np.flatnonzero(usable)
    rng = np.random.default_rng(seed)
    best, best_score = None, -1.0
    for _ in range(300):
        i, j = rng.choice(candidates, 2, replace=False)
        if np.linalg.norm(np.cross(b[i], b[j])) < 1e-3 * max(length[i], length[j]):
            continue
        rotation = fit_rotation(a[[i, j]], b[[i, j]])
        error = conjugation_error(pairs, rotation)
        score = float(np.sum(np.clip(1 - error / _AGREEMENT, 0, None)[usable]))
        if score > best_score:
            best, best_score = rotation, score
    if best is None:
        best = fit_rotation(a[usable], b[usable])
    for _ in range(5):
        agree = (conjugation_error(pairs, best) < _AGREEMENT) & (length < _LARGEST_ANGLE)
        if agree.sum() < 2:
            break
        best = fit_rotation(a[agree], b[agree])
    return best, conjugation_error(pairs, best) < _AGREEMENT


def conjugation_error(pairs: PairRotations, rotation: Array) -> Array:
    """Return (P,) the angle between R_flange and X R_camera X^-1 [rad]."""
    predicted = rotation @ pairs.camera @ rotation.T
    return transforms.rotation_angle(np.swapaxes(pairs.flange, -1, -2) @ predicted)


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """Hand-eye translation and dots with the rotations known.

    Attributes:
        flange_from_camera: (4, 4).
        points: (K, 3) dots in the base frame [m]; NaN where the rays are too parallel.
        error: (M,) reprojection error of every observation [px]; NaN where its dot has no point.
        curvature: (3,) eigenvalues of the reduced normal matrix of the translation, ascending, per observation.
    """

    flange_from_camera: Array
    points: Array
    error: Array
    curvature: Array


def translation_and_points(
    observations: Observations,
    normalised: Array,
    focal: float,
    hand_eye: Array,
    least_parallax: float = np.radians(1.0),
) -> LinearSolution:
    """Solve (I - d d^T)(P_k - t_i - R_i t_X) = 0 for all dots P_k and the hand-eye translation t_X at once.

    d is the ray of an observation in the base frame, t_i and R_i the flange pose of its view. The dots are eliminated,
    a 3x3 system remains; solved five times with weights 1/depth^2 and a Cauchy loss.

    Args:
        observations: M observations of K dots.
        normalised: (M, 2) ideal normalised coordinates.
        focal: [px].
        hand_eye: (3, 3) rotation flange_from_camera.
        least_parallax: Dots whose rays differ by less [rad] get no point.
    """
    view, point = observations.view, observations.point
    poses = observations.base_from_flange
    count = len(observations.dots)
    rays = np.column_stack([normalised, np.ones(len(normalised))])
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    rays = np.einsum("nij,nj->ni", (poses[:, :3, :3] @ hand_eye)[view], rays)
    rotation, origin = poses[view, :3, :3], poses[view, :3, 3]
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]

    plain = sum_by(point, across, count)
    seen_by = np.bincount(point, minlength=count)
    spread = np.linalg.eigvalsh(plain)[:, 0] / np.maximum(seen_by, 1)
    # Two rays at an angle p have a smallest eigenvalue of 1 - cos(p) = p^2 / 2, the mean over both p^2 / 4.
    good = (seen_by > 1) & (spread > least_parallax**2 / 4)
    if good.sum() < 8:
        raise SelfCalibrationError(
            f"only {int(good.sum())} dots are seen with parallax: move the camera farther between views"
        )
    use = good[point]

    weight, depth = np.where(use, 1.0, 0.0), np.ones(len(rays))
    translation, points = np.zeros(3), np.zeros((count, 3))
    curvature = np.zeros(3)
    for _ in range(6):
        w = (weight / depth**2)[:, None, None]
        a = sum_by(point, w * across, count)
        c = sum_by(point, w * (across @ rotation), count)
        g = sum_by(point, w * (across @ origin[:, :, None]), count)
        a_good = a[good] + 1e-12 * np.eye(3)
        a_c, a_g = np.linalg.solve(a_good, c[good]), np.linalg.solve(a_good, g[good])
        turned = np.swapaxes(rotation, -1, -2)
        system = (w * (turned @ across @ rotation)).sum(0) - np.einsum("kji,kjl->il", c[good], a_c)
        right = np.einsum("kji,kjl->il", c[good], a_g) - (w * (turned @ across @ origin[:, :, None])).sum(0)
        translation = np.linalg.lstsq(system, right[:, 0], rcond=1e-10)[0]
        curvature = np.linalg.eigvalsh(system) / max(float((weight / depth**2).sum()), 1e-12)
        points[good] = (a_c @ translation) + a_g[:, :, 0]
        offset = points[point] - origin - rotation @ translation
        depth = np.abs((offset * rays).sum(-1))
        error = focal * np.linalg.norm((across @ offset[:, :, None])[:, :, 0], axis=-1) / np.maximum(depth, 1e-9)
        depth = np.clip(depth, 1e-3 * np.median(depth[use]), None)
        scale = max(1.4826 * float(np.median(error[use])), 0.05)
        weight = np.where(use, 1.0 / (1.0 + (error / (2.5 * scale)) ** 2), 0.0)
    forward = ((offset * rays).sum(-1) > 0)[use]
    if forward.mean() < 0.5:
        raise SelfCalibrationError(
            f"{100 * (1 - forward.mean()):.0f} % of the dots come to lie behind the camera: give base_from_flange poses"
        )
    points[~good] = np.nan
    return LinearSolution(transforms.make(hand_eye, translation), points, np.where(use, error, np.nan), curvature)


def sum_by(index: NDArray[np.int64], values: Array, count: int) -> Array:
    """Sum values (M, ...) of equal index into (count, ...)."""
    flat = values.reshape(len(values), -1)
    out = np.stack([np.bincount(index, column, minlength=count) for column in flat.T], axis=-1)
    return np.asarray(out.reshape(count, *values.shape[1:]), dtype=np.float64)


def resect_projector(points: Array, pixels: Array, size: tuple[int, int]) -> tuple[Array, Array]:
    """Find the projector from points (K, 3) in the base frame and their projector pixels (K, 2).

    Square pixels, no skew, no distortion; the principal point is free, also outside the panel. Started from the direct
    linear transform and, as that fails on nearly flat scenes, from a grid of focal lengths and principal points.

    Returns:
        Camera matrix (3, 3) and base_from_projector (4, 4).
    """
    if len(points) < 12:
        raise DegenerateSceneError(f"{len(points)} dots are too few for the projector, at least 12 are needed")
    chosen = np.linspace(0, len(points) - 1, min(len(points), 400)).astype(np.int64)
    subset, seen = points[chosen], pixels[chosen]
    width, height = size
    starts = [(f * width, width / 2, c * height) for f in (1.2, 2.2, 4.0) for c in (0.0, 0.5, 1.0)]
    linear = _direct_linear_transform(subset, seen)
    if linear is not None:
        starts.insert(0, linear)
    best_cost, best = np.inf, None
    for f, cx, cy in starts:
        pose = _pose_from_points(subset, seen, f, cx, cy)
        if pose is None:
            continue
        result = least_squares(
            _resection_residuals,
            np.array([np.log(f), cx / f, cy / f, *pose]),
            loss="cauchy",
            f_scale=2.0,
            args=(subset, seen),
            max_nfev=60,
        )
        if np.isfinite(result.cost) and result.cost < 0.999 * best_cost:
            best_cost, best = result.cost, result.x
    if best is None:
        raise DegenerateSceneError(
            "no projector explains the dots: did it move between the views, or is the pattern wrong?"
        )
    f = float(np.exp(best[0]))
    matrix = np.array([[f, 0, best[1] * f], [0, f, best[2] * f], [0, 0, 1]])
    projector_from_base = transforms.make(transforms.rotation_exp(best[3:6]), best[6:])
    return matrix, transforms.inverse(projector_from_base)


def _resection_residuals(x: Array, points: Array, pixels: Array) -> Array:
    f = np.exp(np.clip(x[0], -5, 15))
    p = points @ transforms.rotation_exp(x[3:6]).T + x[6:]
    z = np.where(p[:, 2] > 1e-6, p[:, 2], 1e-6)
    return (f * (p[:, :2] / z[:, None] + x[1:3]) - pixels).ravel()


def _pose_from_points(points: Array, pixels: Array, f: float, cx: float, cy: float) -> Array | None:
    """Return rotation vector and translation (6,) of projector_from_base by EPnP, or None."""
    try:
        ok, rotation, translation = cv2.solvePnP(
            points, pixels, np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]]), None, flags=cv2.SOLVEPNP_EPNP
        )
    except cv2.error:
        return None
    pose = np.concatenate([rotation.ravel(), translation.ravel()])
    return pose if ok and np.all(np.isfinite(pose)) else None


def _direct_linear_transform(points: Array, pixels: Array) -> tuple[float, float, float] | None:
    """Return f, cx, cy [px] of the 3x4 matrix that maps points to pixels, or None where it makes no sense."""
    centre, scale = points.mean(0), max(float(points.std()), 1e-9)
    middle, spread = pixels.mean(0), float(pixels.std())
    x = np.column_stack([(points - centre) / scale, np.ones(len(points))])
    u = (pixels - middle) / spread
    zero = np.zeros_like(x)
    system = np.concatenate([np.hstack([x, zero, -u[:, :1] * x]), np.hstack([zero, x, -u[:, 1:] * x])])
    matrix = np.linalg.svd(system, full_matrices=False)[2][-1].reshape(3, 4)
    left = np.diag([spread, spread, 1.0])
    left[:2, 2] = middle
    try:
        k = cv2.decomposeProjectionMatrix(left @ matrix)[0]
    except (cv2.error, StructuredLightError):
        return None
    k = k / k[2, 2]
    f = float(np.sqrt(abs(k[0, 0] * k[1, 1])))
    size = float(np.ptp(pixels, axis=0).max())
    sane = np.all(np.isfinite(k)) and 0.1 * size < f < 50 * size and np.abs(k[:2, 2]).max() < 20 * size
    return (f, float(k[0, 2]), float(k[1, 2])) if sane else None
