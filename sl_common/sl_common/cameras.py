"""Pinhole cameras with radial distortion: none, Pers (the paper's choice, section III.B, reference [8]) or plumb_bob.

A projector is a camera run backwards and uses the same model. Pixel centres are integers: (0, 0) is the centre of the
top-left pixel. Normalised coordinates are x/z, y/z in the optical frame (z forward, x right, y down).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]

COEFFICIENTS = {"none": 0, "pers": 1, "plumb_bob": 5}
"""Number of distortion coefficients of each model."""

_NEWTON_STEPS = 20
_NEWTON_TOLERANCE = 1e-13


@dataclass(frozen=True, eq=False)
class CameraModel:
    """Intrinsics of a camera or projector.

    Attributes:
        width: Image width [px].
        height: Image height [px].
        matrix: (3, 3) float64, fx 0 cx; 0 fy cy; 0 0 1 [px]; the principal point may lie outside the image.
        distortion_model: ``none``, ``pers`` or ``plumb_bob``.
        coefficients: ``pers``: f in units of the focal length, r_u = f sinh(r / f), with r the distorted and r_u the
            ideal radius in normalised coordinates. ``plumb_bob``: k1 k2 p1 p2 k3 (four may be given).
    """

    width: int
    height: int
    matrix: Array
    distortion_model: str = "none"
    coefficients: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        matrix = np.array(self.matrix, dtype=np.float64)
        if self.distortion_model not in COEFFICIENTS:
            raise InvalidInputError(
                f"unknown distortion model '{self.distortion_model}': use one of {', '.join(COEFFICIENTS)}"
            )
        coefficients = tuple(float(c) for c in self.coefficients)
        if self.distortion_model == "plumb_bob":
            coefficients = coefficients + (0.0,) * (5 - len(coefficients))
        expected = COEFFICIENTS[self.distortion_model]
        if len(coefficients) != expected:
            raise InvalidInputError(
                f"distortion model {self.distortion_model} takes {expected} coefficients, got {len(coefficients)}"
            )
        if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)):
            raise InvalidInputError(f"camera matrix must be 3x3 and finite, got shape {matrix.shape}")
        if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
            raise InvalidInputError(f"focal lengths must be positive, got fx {matrix[0, 0]:g}, fy {matrix[1, 1]:g} px")
        if self.distortion_model == "pers" and not coefficients[0] > 0:
            raise InvalidInputError(f"the Pers model needs f > 0, got {coefficients[0]:g}")
        if not np.all(np.isfinite(coefficients)):
            raise InvalidInputError(f"distortion coefficients must be finite, got {coefficients}")
        if self.width <= 0 or self.height <= 0:
            raise InvalidInputError(f"image size must be positive, got {self.width}x{self.height}")
        matrix.flags.writeable = False
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "coefficients", coefficients)

    def project(self, points: ArrayLike) -> Array:
        """Project points (..., 3) [m] of the optical frame to pixels (..., 2); NaN where z <= 0."""
        points = np.asarray(points, dtype=np.float64)
        z = points[..., 2:]
        with np.errstate(divide="ignore", invalid="ignore"):
            normalised = np.where(z > 0, points[..., :2] / z, np.nan)
        return self.to_pixels(self.distort(normalised))

    def rays(self, pixels: ArrayLike) -> Array:
        """Return the rays (..., 3), z = 1, of raw pixels (..., 2); NaN where the model cannot be inverted."""
        normalised = self.undistort(pixels)
        return np.concatenate([normalised, np.ones_like(normalised[..., :1])], axis=-1)

    def undistort(self, pixels: ArrayLike) -> Array:
        """Return ideal normalised coordinates (..., 2) of raw pixels (..., 2); NaN where none."""
        distorted = self.to_normalised(pixels)
        if self.distortion_model == "pers":
            return _scale_radius(distorted, self.coefficients[0], np.sinh)
        if self.distortion_model == "plumb_bob":
            return _undistort_plumb_bob(distorted, self.coefficients)
        return distorted

    def distort(self, normalised: ArrayLike) -> Array:
        """Return distorted normalised coordinates (..., 2) of ideal ones (..., 2); exact inverse of undistortion."""
        ideal = np.asarray(normalised, dtype=np.float64)
        if self.distortion_model == "pers":
            return _scale_radius(ideal, self.coefficients[0], np.arcsinh)
        if self.distortion_model == "plumb_bob":
            return _distort_plumb_bob(ideal, self.coefficients)
        return ideal

    def to_pixels(self, distorted: ArrayLike) -> Array:
        """Map distorted normalised coordinates (..., 2) to pixels (..., 2) by the camera matrix."""
        x = np.asarray(distorted, dtype=np.float64)
        return x @ self.matrix[:2, :2].T + self.matrix[:2, 2]

    def to_normalised(self, pixels: ArrayLike) -> Array:
        """Map pixels (..., 2) to distorted normalised coordinates (..., 2) by the inverse of the camera matrix."""
        x = np.asarray(pixels, dtype=np.float64) - self.matrix[:2, 2]
        return x @ np.linalg.inv(self.matrix[:2, :2]).T

    def contains(self, pixels: ArrayLike) -> NDArray[np.bool_]:
        """Tell which pixels (..., 2) lie inside the image (its outer pixels' edges included)."""
        x = np.asarray(pixels, dtype=np.float64)
        return (x >= -0.5).all(-1) & (x[..., 0] <= self.width - 0.5) & (x[..., 1] <= self.height - 0.5)

    def as_plumb_bob(self) -> "CameraModel":
        """Return the plumb_bob model (k1 k2 k3) nearest to this one over the image, for REP-104's CameraInfo."""
        if self.distortion_model != "pers":
            return CameraModel(self.width, self.height, self.matrix, "plumb_bob", self.coefficients or (0.0,) * 5)
        u = np.linspace(0, self.width - 1, 41)
        v = np.linspace(0, self.height - 1, 31)
        pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
        ideal = self.undistort(pixels)
        distorted = self.to_normalised(pixels)
        r2 = (ideal**2).sum(-1, keepdims=True)
        basis = np.stack([ideal * r2, ideal * r2**2, ideal * r2**3], axis=-1).reshape(-1, 3)
        k, *_ = np.linalg.lstsq(basis, (distorted - ideal).reshape(-1), rcond=None)
        return CameraModel(self.width, self.height, self.matrix, "plumb_bob", (k[0], k[1], 0.0, 0.0, k[2]))


def _scale_radius(x: Array, f: float, function: np.ufunc) -> Array:
    """Replace the radius r of points (..., 2) by ``f function(r / f)``; sinh/asinh avoid the cancellation of exp."""
    r = np.linalg.norm(x, axis=-1, keepdims=True) / f
    tiny = r < 1e-6
    with np.errstate(over="ignore"):
        scale = np.where(tiny, 1.0, function(r) / np.where(tiny, 1.0, r))
    return x * scale


def _distort_plumb_bob(ideal: Array, coefficients: tuple[float, ...]) -> Array:
    k1, k2, p1, p2, k3 = coefficients
    x, y = ideal[..., 0], ideal[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def _plumb_bob_jacobian(ideal: Array, coefficients: tuple[float, ...]) -> Array:
    """Return d distorted / d ideal (..., 2, 2)."""
    k1, k2, p1, p2, k3 = coefficients
    x, y = ideal[..., 0], ideal[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
    xy = slope * x * y + 2 * p1 * x + 2 * p2 * y
    jacobian = np.empty((*ideal.shape[:-1], 2, 2))
    jacobian[..., 0, 0] = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    jacobian[..., 0, 1] = jacobian[..., 1, 0] = xy
    jacobian[..., 1, 1] = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    return jacobian


def _undistort_plumb_bob(distorted: Array, coefficients: tuple[float, ...]) -> Array:
    """Invert the plumb_bob model by damped Newton steps; NaN where none converges on the branch through the centre."""
    if not any(coefficients):
        return distorted
    x = distorted.copy()
    residual = _distort_plumb_bob(x, coefficients) - distorted
    for _ in range(_NEWTON_STEPS):
        jacobian = _plumb_bob_jacobian(x, coefficients)
        determinant = np.linalg.det(jacobian)
        usable = np.abs(determinant) > 1e-9
        jacobian[~usable] = np.eye(2)
        step = np.linalg.solve(jacobian, residual[..., None])[..., 0]
        limit = 0.5 * (np.linalg.norm(x, axis=-1, keepdims=True) + 0.1)
        length = np.linalg.norm(step, axis=-1, keepdims=True)
        x = x - step * np.minimum(1.0, limit / np.maximum(length, 1e-300))
        residual = _distort_plumb_bob(x, coefficients) - distorted
        if np.nanmax(np.abs(residual), initial=0.0) < _NEWTON_TOLERANCE:
            break
    # On the branch through the centre the map keeps its orientation all the way out: both eigenvalues stay positive.
    jacobian = _plumb_bob_jacobian(x, coefficients)
    proper = (np.linalg.det(jacobian) > 0) & (np.trace(jacobian, axis1=-2, axis2=-1) > 0)
    converged = np.abs(residual).max(-1) < 1e-9
    return np.where((proper & converged)[..., None], x, np.nan)
