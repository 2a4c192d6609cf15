"""The centroid of a dot's image is not the image of its centre.

A decoder measures centroids. Perspective, the curvature of the surface and the light on it shift them by hundredths of
a pixel; the shift due to light is the same in every view, so it does not average out, and it is what limits the
projector's focal length. For a disc of variance s (R^2 / 4 along each axis in the projector image, plus the blur of the
projector), whose point u appears at x(u) in the camera image with brightness E(u), to second order

    centroid - x(u0) = s ( (x_uu + x_vv) / 2 + J grad(log E + log |det J|) ),    J = dx / du.

The surface is known from the dots themselves, and so is this displacement but for its factor s, which is estimated
along with all else. E goes with the cosine of the light's angle over the square of its distance (matt surfaces).
"""

import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration.views import Observations
from sl_common import transforms
from sl_common.cameras import CameraModel

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_STEEPEST = 0.05  # [1/px] change of log E; more is an edge, not shading
_BEND = 0.15  # largest error of a local plane, as a share of the distance of the dots on the surface
_CREASE = 0.01  # largest error of a local quadric, likewise
_GRAZING = 0.15  # cosine of the angle of incidence below which the light cannot be trusted
_STEP = 2.0  # [projector px] of the differences


def prior(spot_diameter: float) -> tuple[float, float]:
    """Return mean and standard deviation of the factor s [projector px^2] of discs of a diameter."""
    sharp = (spot_diameter / 2) ** 2 / 4
    return sharp, 0.5 * sharp


def displacements(
    observations: Observations,
    points: Array,
    base_from_camera: Array,
    base_from_projector: Array,
    camera: CameraModel,
    projector: CameraModel,
) -> tuple[Array, BoolArray]:
    """Return each observation's displacement over s (M, 2) [camera px / projector px^2], and where it is known.

    Args:
        observations: M observations of K dots in V views.
        points: (K, 3) dots in the base frame [m].
        base_from_camera: (V, 4, 4).
        base_from_projector: (4, 4).
        camera: Camera model.
        projector: Projector model.

    Returns:
        Displacements, 0 where unknown, and (K,) whether the surface around the dot is smooth enough to know it.
    """
    dots, pixels = observations.dots, observations.projector_pixels
    in_projector = transforms.apply(transforms.inverse(base_from_projector), points)
    neighbours = _Neighbourhood(dots, pixels)
    light, known = _light(neighbours, in_projector)
    light_slope, _, complete = neighbours.linear(np.where(known, light, np.nan)[:, None], 9)
    light_slope = light_slope[:, 0]
    coefficients, _, solid = neighbours.quadratic(1.0 / in_projector[:, 2:])
    surface = coefficients[:, :, 0]
    known &= complete & solid
    known &= np.linalg.norm(np.nan_to_num(light_slope, nan=1.0), axis=-1) < _STEEPEST

    stencil = _STEP * np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)], dtype=np.float64)
    du, dv = stencil[:, 0], stencil[:, 1]
    basis = np.stack([np.ones(9), du, dv, du**2 / 2, du * dv, dv**2 / 2])
    inverse_depth = np.where(known[:, None], surface, 1.0) @ basis
    rays = projector.rays(pixels[:, None, :] + stencil)
    around = transforms.apply(base_from_projector, (rays / inverse_depth[:, :, None]).reshape(-1, 3)).reshape(-1, 9, 3)

    out = np.zeros((len(observations.view), 2))
    for i, pose in enumerate(transforms.inverse(base_from_camera)):
        mine = np.flatnonzero((observations.view == i) & known[observations.point])
        k = observations.point[mine]
        seen = camera.project(transforms.apply(pose, around[k].reshape(-1, 3))).reshape(-1, 9, 2)
        shift = _displacement(seen, light_slope[k])
        out[mine] = np.where(np.isfinite(shift).all(-1, keepdims=True), shift, 0.0)
    return out, known


def _displacement(x: Array, light_slope: Array) -> Array:
    """Apply the formula above to a 3x3 stencil of pixels (N, 9, 2), first index along u, and grad log E (N, 2)."""
    g = x.reshape(-1, 3, 3, 2)
    x_u, x_v = (g[:, 2, 1] - g[:, 0, 1]) / (2 * _STEP), (g[:, 1, 2] - g[:, 1, 0]) / (2 * _STEP)
    x_uu = (g[:, 2, 1] - 2 * g[:, 1, 1] + g[:, 0, 1]) / _STEP**2
    x_vv = (g[:, 1, 2] - 2 * g[:, 1, 1] + g[:, 1, 0]) / _STEP**2
    x_uv = (g[:, 2, 2] - g[:, 2, 0] - g[:, 0, 2] + g[:, 0, 0]) / (4 * _STEP**2)

    def cross(a: Array, b: Array) -> Array:
        return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]

    det = cross(x_u, x_v)
    det_slope = np.stack([cross(x_uu, x_v) + cross(x_u, x_uv), cross(x_uv, x_v) + cross(x_u, x_vv)], axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = light_slope + det_slope / det[:, None]
    return (x_uu + x_vv) / 2 + x_u * slope[:, :1] + x_v * slope[:, 1:]


def _light(neighbours: "_Neighbourhood", in_projector: Array) -> tuple[Array, BoolArray]:
    """Return log E (K,) up to a constant, and where the surface is smooth enough to trust it."""
    tangents, error, solid = neighbours.linear(in_projector)
    _, crease, _ = neighbours.quadratic(in_projector)
    normal = np.cross(tangents[:, :, 0], tangents[:, :, 1])
    distance = np.linalg.norm(in_projector, axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = np.abs((normal * in_projector).sum(-1)) / (np.linalg.norm(normal, axis=-1) * distance)
        light = np.log(cosine) - 2 * np.log(distance)
        step = np.linalg.norm(tangents, axis=(-2, -1)) * neighbours.spacing
        known = solid & np.isfinite(light) & (cosine > _GRAZING) & (error < _BEND * step) & (crease < _CREASE * step)
    return light, known


class _Neighbourhood:
    """The 3x3 neighbours of every dot in the pattern, for local fits over the projector image.

    Attributes:
        spacing: Median distance of neighbouring dots [px].
    """

    def __init__(self, dots: NDArray[np.int64], pixels: Array) -> None:
        rows, cols = dots.max(0) + 3
        self._index = np.full((rows, cols), -1)
        self._index[dots[:, 0] + 1, dots[:, 1] + 1] = np.arange(len(dots))
        around = [(i, j) for i in (0, 1, 2) for j in (0, 1, 2)]
        self._near = np.stack([self._index[dots[:, 0] + i, dots[:, 1] + j] for i, j in around], axis=1)
        self._offset = pixels[self._near] - pixels[:, None, :]
        distance = np.linalg.norm(self._offset[:, 5][self._near[:, 5] >= 0], axis=-1)
        self.spacing = float(np.median(distance)) if len(distance) else 1.0

    def _fit(self, values: Array, basis: Array, least: int) -> tuple[Array, Array, BoolArray]:
        """Fit values (K, n) by a basis (K, 9, B); returns coefficients (K, B, n), largest errors and validity (K,)."""
        near = values[self._near]
        there = (self._near >= 0) & np.isfinite(near).all(-1)
        basis = np.where(there[:, :, None], basis, 0.0)
        target = np.where(there[:, :, None], near, 0.0)
        normal = np.swapaxes(basis, -1, -2) @ basis
        scale = np.sqrt(np.maximum(np.diagonal(normal, axis1=-2, axis2=-1), 1e-300))
        scaled = normal / scale[:, :, None] / scale[:, None, :]
        solid = (there.sum(1) >= least) & there[:, 4]
        solid &= np.linalg.eigvalsh(scaled)[:, 0] > 1e-3
        scaled[~solid] = np.eye(basis.shape[-1])
        right = (np.swapaxes(basis, -1, -2) @ target) / scale[:, :, None]
        coefficients = np.linalg.solve(scaled, right) / scale[:, :, None]
        error = np.linalg.norm(target - basis @ coefficients, axis=-1).max(-1)
        coefficients[~solid], error[~solid] = np.nan, np.nan
        return coefficients, error, solid

    def linear(self, values: Array, least: int = 6) -> tuple[Array, Array, BoolArray]:
        """Return the slopes (K, n, 2) by u and v of values (K, n), the largest errors (K,) and the validity (K,)."""
        basis = np.concatenate([np.ones((*self._near.shape, 1)), self._offset], axis=-1)
        coefficients, error, solid = self._fit(values, basis, least)
        return np.swapaxes(coefficients[:, 1:], -1, -2), error, solid

    def quadratic(self, values: Array) -> tuple[Array, Array, BoolArray]:
        """Return the 1, u, v, uu/2, uv, vv/2 coefficients (K, 6, n) of values (K, n), errors (K,) and validity (K,)."""
        u, v = self._offset[:, :, 0] / self.spacing, self._offset[:, :, 1] / self.spacing
        basis = np.stack([np.ones_like(u), u, v, u * u / 2, u * v, v * v / 2], axis=-1)
        coefficients, error, solid = self._fit(values, basis, 7)
        units = np.array([1.0, self.spacing, self.spacing, *[self.spacing**2] * 3])
        return coefficients / units[:, None], error, solid
