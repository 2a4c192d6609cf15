"""A robust local fit of a surface: point, outward normal and their uncertainty."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from arm_positioner.errors import TargetError
from arm_positioner.kriging import HeightFit, fit_height

Array = NDArray[np.float64]

_NEIGHBOURS = 120
"""Points of a neighbourhood: about six dots in each direction."""
_CORE = 25
"""Points that give the first plane, and how rough the surface is."""
_JUDGES = 150
"""Points that decide between candidate planes."""
_GROSS = 8.0
"""Robust standard deviations from a quadric beyond which points are not believed to begin with."""
_TURN = 0.1
"""Angle between normal and axis of the height field past which the field is turned and fitted again [rad]."""


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """When a fit is good enough to drive an arm by.

    Attributes:
        min_points: Fewest inliers.
        max_rms: Largest RMS distance of the inliers from the surface [m].
        min_inliers: Smallest share of inliers within the radius.
        max_normal_sigma: Largest standard deviation of the normal [rad].
        max_tilt: Largest angle between normal and line of sight [rad].
        place_sigma: Standard deviation of errors that all points have in common [m], such as the calibration's: on a
            curved surface the normal is known no better than the place.
    """

    min_points: int = 12
    max_rms: float = 0.005
    min_inliers: float = 0.5
    max_normal_sigma: float = 0.05
    max_tilt: float = 1.4
    place_sigma: float = 0.0005


@dataclass(frozen=True, eq=False)
class SurfacePatch:
    """A piece of surface.

    Attributes:
        point: (3,) on the surface [m].
        normal: (3,) unit normal, towards the viewer.
        covariance: (3, 3) of the distance along the normal [m] and the normal's tilt along two tangents [rad], where
            the latter includes what an error of the place makes on a curved surface.
        tangents: (2, 3) the two tangents.
        radius: Of the neighbourhood used [m].
        count: Number of inliers.
        share: Their share of the points within the radius.
        rms: Noise of the points along the normal [m].
    """

    point: Array
    normal: Array
    covariance: Array
    tangents: Array
    radius: float
    count: int
    share: float
    rms: float

    @property
    def normal_sigma(self) -> float:
        """Standard deviation of the normal in its worst direction [rad]."""
        return float(np.sqrt(max(np.linalg.eigvalsh(self.covariance[1:, 1:])[-1], 0.0)))

    @property
    def height_sigma(self) -> float:
        """Standard deviation of the point along the normal [m]."""
        return float(np.sqrt(self.covariance[0, 0]))

    def angle_to(self, viewpoint: Array) -> float:
        """Return the angle between the normal and the line of sight to ``viewpoint`` (3,) [rad]."""
        sight = viewpoint - self.point
        return float(np.arccos(np.clip(self.normal @ sight / np.linalg.norm(sight), -1, 1)))


def fit_patch(
    points: Array, weights: Array, centre: Array, viewpoint: Array, spacing: float, *, options: FitOptions | None = None
) -> SurfacePatch:
    """Fit a surface to the points nearest ``centre`` and return its point and normal there.

    How far points count is judged from the points: a flat face averages all of the neighbourhood, a curved one only as
    much as its own roughness beside the noise permits; see :mod:`arm_positioner.kriging`. Heights are measured along
    the normal itself. Points that their neighbours do not predict are left out.

    Args:
        points: (N, 3) points of one coherent patch [m].
        weights: (N,) confidence in 0..1.
        centre: (3,) near which to fit [m].
        viewpoint: (3,) the camera's position, to which the normal points [m].
        spacing: Typical distance between neighbouring points [m].
        options: What is good enough.

    Raises TargetError with the numbers where the fit is too poor.
    """
    options = options or FitOptions()
    distance = np.linalg.norm(points - centre, axis=1)
    near = np.argsort(distance, kind="stable")[:_NEIGHBOURS]
    if len(near) < options.min_points:
        raise TargetError(
            f"only {len(near)} points on the object, at least {options.min_points} are needed; move the camera so that "
            "more of the pattern is seen on it"
        )
    local, weights, radius = points[near] - centre, np.clip(weights[near], 0.05, 1.0), float(distance[near[-1]])
    normal = _robust_plane(local[:_CORE], weights[:_CORE])
    for _ in range(4):
        normal = normal if normal @ (viewpoint - centre) > 0 else -normal
        tangents = _tangents(normal)
        fit = _fit(local, weights, normal, tangents, spacing)
        axis, slopes = normal, fit.estimate[1:]
        normal = axis - slopes @ tangents
        normal /= np.linalg.norm(normal)
        if np.hypot(*slopes) < np.tan(_TURN):
            break
    patch = SurfacePatch(
        centre + fit.estimate[0] * axis,
        normal,
        _with_place(fit, options.place_sigma),
        _turned(tangents, normal),
        radius,
        int(np.count_nonzero(fit.inliers)),
        float(np.mean(fit.inliers)),
        fit.noise,
    )
    _judge(patch, viewpoint, options)
    return patch


def _fit(local: Array, weights: Array, normal: Array, tangents: Array, spacing: float) -> HeightFit:
    """Fit a height field along ``normal`` to points (N, 3) around the origin."""
    places, heights = local @ tangents.T, local @ normal
    return fit_height(places, heights, weights, _believable(places, heights, spacing), spacing)


def _with_place(fit: HeightFit, place_sigma: float) -> Array:
    """Return the fit's covariance (3, 3) with that of a place known to ``place_sigma`` along the surface."""
    covariance = fit.covariance.copy()
    covariance[1:, 1:] += place_sigma**2 * fit.bending @ fit.bending.T
    return covariance


def _believable(places: Array, heights: Array, spacing: float) -> NDArray[np.bool_]:
    """Tell which points (N,) are not far off a quadric of least absolute deviations."""
    x, y = places.T / spacing
    design = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    if len(x) < 4 * design.shape[1]:
        design = design[:, :3]
    near = np.exp(-(x * x + y * y) / 18.0)
    w = near
    for _ in range(15):
        root = np.sqrt(w)
        solution = np.linalg.lstsq(design * root[:, None], heights * root, rcond=None)[0]
        residual = np.abs(heights - design @ solution)
        w = near / np.maximum(residual, 1e-3 * spacing)
    core = residual[:_CORE]
    return residual <= _GROSS * max(1.4826 * float(np.median(core)), 1.4826 * float(np.median(residual)), 1e-9)


def _tangents(normal: Array) -> Array:
    return _turned(np.eye(3)[[np.argmin(np.abs(normal))]], normal)


def _turned(tangents: Array, normal: Array) -> Array:
    """Return the tangents (2, 3) turned as little as it takes to lie across ``normal``."""
    first = tangents[0] - (tangents[0] @ normal) * normal
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(normal, first)])


def _judge(patch: SurfacePatch, viewpoint: Array, options: FitOptions) -> None:
    """Raise TargetError where the patch is not good enough."""
    if patch.count < options.min_points or patch.share < options.min_inliers:
        raise TargetError(
            f"surface fit refused: {patch.count} of its points ({100 * patch.share:.0f} %) lie on one surface, at "
            f"least {options.min_points} and {100 * options.min_inliers:.0f} % are needed"
        )
    if not patch.rms <= options.max_rms:
        raise TargetError(
            f"surface fit refused: RMS {1e3 * patch.rms:.2f} mm over {patch.count} points, "
            f"limit {1e3 * options.max_rms:.2f} mm"
        )
    if not patch.normal_sigma <= options.max_normal_sigma:
        raise TargetError(
            f"surface fit refused: the normal is known to {np.degrees(patch.normal_sigma):.1f} deg only, limit "
            f"{np.degrees(options.max_normal_sigma):.1f} deg ({patch.count} points)"
        )
    tilt = patch.angle_to(viewpoint)
    if tilt > options.max_tilt:
        raise TargetError(
            f"surface seen at {np.degrees(tilt):.0f} deg from its normal, limit "
            f"{np.degrees(options.max_tilt):.0f} deg; move the camera to face it"
        )


def _robust_plane(points: Array, weights: Array) -> Array:
    """Return the normal of the plane with the least median distance over random triples, then refined."""
    rng = np.random.default_rng(len(points))
    triples = points[rng.integers(0, len(points), size=(120, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    length = np.linalg.norm(normals, axis=1)
    scale = float(np.median(length))
    usable = length > max(0.05 * scale, 1e-15)
    if not usable.any():
        raise TargetError("the points of the object lie on a line: no surface normal; move the camera closer")
    normals, origins = normals[usable] / length[usable, None], triples[usable, 0]
    judges = points[rng.permutation(len(points))[:_JUDGES]]
    residuals = np.abs(normals @ judges.T - np.einsum("ij,ij->i", normals, origins)[:, None])
    medians = np.median(residuals, axis=1)
    best = int(np.argmin(medians))
    inliers = np.abs((points - origins[best]) @ normals[best]) <= 2.5 * 1.4826 * medians[best] + 1e-9
    w = np.maximum(weights[inliers], 1e-3)
    centred = (points[inliers] - np.average(points[inliers], axis=0, weights=w)) * np.sqrt(w)[:, None]
    normal: Array = np.linalg.svd(centred, full_matrices=False)[2][2]
    return normal
