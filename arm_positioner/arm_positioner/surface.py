"""A robust local fit of a surface: point, outward normal and their uncertainty."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from arm_positioner.errors import TargetError

Array = NDArray[np.float64]

_PARAMETERS = 6  # of the quadric
_TUKEY = 4.685  # 95 % efficiency for normal noise
_ENOUGH = 400
"""Points in a neighbourhood past which it need not grow: calibration errors then outweigh the noise."""
_JUDGES = 150
"""Points that decide between candidate planes."""
_AGREEMENT = 2.0
"""Standard deviations within which neighbourhoods of different size have to agree."""
_ROUNDING = np.array([1e-5, 1e-4, 1e-4])  # m, rad, rad


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """When a fit is good enough to drive an arm by.

    Attributes:
        min_points: Fewest inliers.
        max_rms: Largest RMS distance of the inliers from the surface [m].
        min_inliers: Smallest share of inliers within the radius.
        max_normal_sigma: Largest standard deviation of the normal [rad].
        max_tilt: Largest angle between normal and line of sight [rad].
    """

    min_points: int = 12
    max_rms: float = 0.005
    min_inliers: float = 0.5
    max_normal_sigma: float = 0.05
    max_tilt: float = 1.4


@dataclass(frozen=True, eq=False)
class SurfacePatch:
    """A piece of surface.

    Attributes:
        point: (3,) on the surface [m].
        normal: (3,) unit normal, towards the viewer.
        covariance: (3, 3) of the distance along the normal [m] and the normal's tilt along two tangents [rad].
        tangents: (2, 3) the two tangents.
        radius: Of the neighbourhood used [m].
        count: Number of inliers.
        rms: Of their distances from the surface, corrected for the fit's freedom [m].
    """

    point: Array
    normal: Array
    covariance: Array
    tangents: Array
    radius: float
    count: int
    rms: float


def fit_patch(
    points: Array, weights: Array, centre: Array, viewpoint: Array, spacing: float, *, options: FitOptions | None = None
) -> SurfacePatch:
    """Fit a quadric z = a + b x + c y + d x^2 + e x y + f y^2 around ``centre`` and return its point and normal there.

    The radius follows the data: it grows while point and normal stay within the uncertainty of every smaller
    neighbourhood (Lepski's rule), so that a flat face averages many dots and a curved one only as many as a quadric can
    describe. Outliers are found by a least-median-of-squares plane and weighted down by Tukey's function.

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
    order = np.argsort(distance, kind="stable")
    distance = distance[order]
    accepted: list[SurfacePatch] = []
    failure = ""
    first = min(2 * options.min_points, len(distance)) - 1
    radius = max(3.0 * spacing, float(distance[first]) if len(distance) else 0.0)
    while True:
        near = order[: int(np.searchsorted(distance, radius, side="right"))]
        try:
            patch = _fit(points[near], weights[near], centre, viewpoint, radius, options)
            if not all(_agrees(patch, smaller) for smaller in accepted):
                break
            accepted.append(patch)
        except TargetError as error:
            failure = str(error)
            if accepted:
                break
        if len(near) >= min(len(points), _ENOUGH):
            break
        radius *= 1.25
    if not accepted:
        raise TargetError(failure)
    return accepted[-1]


def _agrees(patch: SurfacePatch, smaller: SurfacePatch) -> bool:
    """Whether a larger patch's point and normal lie within the uncertainty of a smaller one."""
    noisier = max(1.0, patch.rms / max(smaller.rms, 1e-12))
    sigma = noisier * np.sqrt(np.maximum(np.diag(smaller.covariance), 0.0))
    off = np.concatenate([[(patch.point - smaller.point) @ smaller.normal], smaller.tangents @ patch.normal])
    off[1:] -= smaller.tangents @ smaller.normal
    return bool((np.abs(off) <= _AGREEMENT * sigma + _ROUNDING).all())


def _fit(
    points: Array, weights: Array, centre: Array, viewpoint: Array, radius: float, options: FitOptions
) -> SurfacePatch:
    if len(points) < options.min_points:
        raise TargetError(
            f"only {len(points)} points within {1e3 * radius:.0f} mm of the object's centre, at least "
            f"{options.min_points} are needed; move the camera so that more of the pattern is seen on the object"
        )
    origin, normal = _robust_plane(points, weights)
    sight = viewpoint - origin
    normal = normal if normal @ sight > 0 else -normal
    t1 = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    t1 /= np.linalg.norm(t1)
    tangents = np.stack([t1, np.cross(normal, t1)])
    x, y = tangents @ (points - centre).T / radius
    z = (points - centre) @ normal
    full = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    design = full if len(points) >= 4 * _PARAMETERS else full[:, :3]
    solution, used, sigma, inverse = _tukey(design, z, weights, z - (origin - centre) @ normal)
    count = int(np.count_nonzero(used))
    share = count / len(points)
    gradient = solution[1:3] / radius
    outward = normal - gradient @ tangents
    outward /= np.linalg.norm(outward)
    patch = SurfacePatch(
        centre + solution[0] * normal,
        outward,
        sigma**2 * (inverse[:3, :3] / np.outer((1, radius, radius), (1, radius, radius))),
        tangents,
        radius,
        count,
        sigma if count else np.inf,
    )
    _judge(patch, share, viewpoint, options)
    return patch


def _judge(patch: SurfacePatch, share: float, viewpoint: Array, options: FitOptions) -> None:
    """Raise TargetError where the patch is not good enough."""
    if patch.count < options.min_points or share < options.min_inliers:
        raise TargetError(
            f"surface fit refused: {patch.count} of its points ({100 * share:.0f} %) lie on one surface, at least "
            f"{options.min_points} and {100 * options.min_inliers:.0f} % are needed"
        )
    if not patch.rms <= options.max_rms:
        raise TargetError(
            f"surface fit refused: RMS {1e3 * patch.rms:.2f} mm over {patch.count} points, "
            f"limit {1e3 * options.max_rms:.2f} mm"
        )
    tilt_sigma = float(np.sqrt(max(np.linalg.eigvalsh(patch.covariance[1:, 1:])[-1], 0.0)))
    if not tilt_sigma <= options.max_normal_sigma:
        raise TargetError(
            f"surface fit refused: the normal is known to {np.degrees(tilt_sigma):.1f} deg only, limit "
            f"{np.degrees(options.max_normal_sigma):.1f} deg ({patch.count} points)"
        )
    sight = viewpoint - patch.point
    tilt = float(np.arccos(np.clip(patch.normal @ sight / np.linalg.norm(sight), -1, 1)))
    if tilt > options.max_tilt:
        raise TargetError(
            f"surface seen at {np.degrees(tilt):.0f} deg from its normal, limit "
            f"{np.degrees(options.max_tilt):.0f} deg; move the camera to face it"
        )


def _robust_plane(points: Array, weights: Array) -> tuple[Array, Array]:
    """Return a point and the normal of the plane with the least median distance over random triples, then refined."""
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
    origin = np.average(points[inliers], axis=0, weights=w)
    centred = (points[inliers] - origin) * np.sqrt(w)[:, None]
    return origin, np.linalg.svd(centred, full_matrices=False)[2][2]


def _tukey(design: Array, z: Array, weights: Array, start: Array) -> tuple[Array, NDArray[np.bool_], float, Array]:
    """Iteratively reweighted fit; ``start`` (N,) are residuals to begin with.

    Returns the solution, the inliers (N,), the noise's standard deviation and the inverse normal matrix.
    """
    residual = start
    w0 = np.clip(weights, 0.05, 1.0)
    solution = np.zeros(design.shape[1])
    used = np.ones(len(z), dtype=bool)
    inverse: Array = np.eye(design.shape[1])
    sigma = np.inf
    for _ in range(12):
        sigma = max(1.4826 * float(np.median(np.abs(residual))), 1e-9)
        u = residual / (_TUKEY * sigma)
        used = np.abs(u) < 1
        w = np.where(used, w0 * (1 - u * u) ** 2, 0.0)
        normal = design.T @ (w[:, None] * design)
        inverse = np.asarray(np.linalg.pinv(normal, hermitian=True), dtype=np.float64)
        update = inverse @ (design.T @ (w * z))
        done = bool(np.allclose(update, solution, rtol=1e-6, atol=1e-9))
        solution, residual = update, z - design @ update
        if done:
            break
    freedom = max(int(np.count_nonzero(used)) - design.shape[1], 1)
    sigma = float(np.sqrt(np.sum(residual[used] ** 2) / freedom))
    return solution, used, sigma, inverse
