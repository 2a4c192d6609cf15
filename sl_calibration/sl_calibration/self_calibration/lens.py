"""Projection with analytic derivatives, for the bundle adjustment.

The models are those of :mod:`sl_common.cameras`, with the parameters in one vector: fx fy cx cy and the coefficients of
the distortion model.
"""

import numpy as np
from numpy.typing import NDArray

from sl_common.cameras import COEFFICIENTS, CameraModel

Array = NDArray[np.float64]

MATRIX_PARAMETERS = ("fx", "fy", "cx", "cy")
COEFFICIENT_NAMES = {"none": (), "pers": ("f",), "plumb_bob": ("k1", "k2", "p1", "p2", "k3")}


def names(distortion_model: str) -> tuple[str, ...]:
    """Return the names of a model's parameters in their order."""
    return MATRIX_PARAMETERS + COEFFICIENT_NAMES[distortion_model]


def parameters(model: CameraModel) -> Array:
    """Return fx fy cx cy [px] and the distortion coefficients of a model as one vector."""
    k = model.matrix
    return np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2], *model.coefficients])


def with_parameters(model: CameraModel, vector: Array) -> CameraModel:
    """Return the model with the parameters of a vector as :func:`parameters` gives it."""
    fx, fy, cx, cy = vector[:4]
    matrix = np.array([[fx, model.matrix[0, 1], cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return CameraModel(model.width, model.height, matrix, model.distortion_model, tuple(vector[4:]))


def project(distortion_model: str, vector: Array, points: Array) -> tuple[Array, Array, Array]:
    """Project points and differentiate.

    Args:
        distortion_model: ``none``, ``pers`` or ``plumb_bob``.
        vector: (P,) fx fy cx cy and coefficients.
        points: (N, 3) in the optical frame [m], z not zero.

    Returns:
        Pixels (N, 2), their derivative by the points (N, 2, 3) [px/m], and by the parameters (N, 2, P).
    """
    focal = vector[:2]
    z = points[:, 2:]
    ideal = points[:, :2] / z
    distorted, by_ideal, by_coefficients = _distort(distortion_model, vector[4:], ideal)
    pixels = focal * distorted + vector[2:4]

    ideal_by_point = np.zeros((len(points), 2, 3))
    ideal_by_point[:, 0, 0] = ideal_by_point[:, 1, 1] = 1.0 / z[:, 0]
    ideal_by_point[:, :, 2] = -ideal / z
    by_points = focal[:, None] * (by_ideal @ ideal_by_point)

    by_parameters = np.zeros((len(points), 2, 4 + COEFFICIENTS[distortion_model]))
    by_parameters[:, 0, 0], by_parameters[:, 1, 1] = distorted[:, 0], distorted[:, 1]
    by_parameters[:, 0, 2] = by_parameters[:, 1, 3] = 1.0
    by_parameters[:, :, 4:] = focal[:, None] * by_coefficients
    return pixels, by_points, by_parameters


def _distort(distortion_model: str, coefficients: Array, x: Array) -> tuple[Array, Array, Array]:
    """Return distorted points (N, 2), their derivatives by the ideal ones (N, 2, 2) and by the coefficients."""
    if distortion_model == "pers":
        return _distort_pers(float(coefficients[0]), x)
    if distortion_model == "plumb_bob":
        return _distort_plumb_bob(coefficients, x)
    return x, np.broadcast_to(np.eye(2), (len(x), 2, 2)), np.zeros((len(x), 2, 0))


def _distort_pers(f: float, x: Array) -> tuple[Array, Array, Array]:
    """r = f asinh(r_u / f), the paper's model (section III.B) solved for the distorted radius."""
    radius = np.linalg.norm(x, axis=-1)
    u = radius / f
    small = u < 1e-4
    safe = np.where(small, 1.0, u)
    scale = np.where(small, 1.0 - u**2 / 6, np.arcsinh(safe) / safe)
    # d scale / d r_u, divided by r_u; its limit at the centre is -1 / (3 f^2).
    slope = np.where(small, -1.0 / 3, (1.0 / np.sqrt(1 + safe**2) - scale) / safe**2) / f**2
    by_ideal = scale[:, None, None] * np.eye(2) + slope[:, None, None] * x[:, :, None] * x[:, None, :]
    by_f = np.where(small, u**2 / 3, (np.arcsinh(u) - u / np.sqrt(1 + u**2)) / safe) / f
    return x * scale[:, None], by_ideal, (x * by_f[:, None])[:, :, None]


def _distort_plumb_bob(coefficients: Array, x: Array) -> tuple[Array, Array, Array]:
    k1, k2, p1, p2, k3 = coefficients
    a, b = x[:, 0], x[:, 1]
    r2 = a * a + b * b
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    distorted = np.stack(
        [
            a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a),
            b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b,
        ],
        axis=-1,
    )
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
    by_ideal = np.empty((len(x), 2, 2))
    by_ideal[:, 0, 0] = radial + slope * a * a + 2 * p1 * b + 6 * p2 * a
    by_ideal[:, 1, 1] = radial + slope * b * b + 6 * p1 * b + 2 * p2 * a
    by_ideal[:, 0, 1] = by_ideal[:, 1, 0] = slope * a * b + 2 * p1 * a + 2 * p2 * b
    tangential_1 = np.stack([2 * a * b, r2 + 2 * b * b], axis=-1)
    tangential_2 = np.stack([r2 + 2 * a * a, 2 * a * b], axis=-1)
    by_coefficients = np.stack(
        [x * r2[:, None], x * r2[:, None] ** 2, tangential_1, tangential_2, x * r2[:, None] ** 3], axis=-1
    )
    return distorted, by_ideal, by_coefficients
