"""Height, slopes and bending of a surface at one place by kriging: the noise decides how far around it is averaged.

A height field is a quadric (or a plane) plus a smooth random field plus noise. How long the waves of the field are, and
how high beside the noise, is judged by the restricted likelihood; instead of one best answer all plausible ones are
averaged by their likelihood, so that the uncertainty covers the choice too (Rasmussen and Williams, Gaussian Processes
for Machine Learning, 2006, sections 2.7 and 5.4).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LENGTHS = (2.0, 4.0, 8.0, 16.0)
"""Correlation lengths tried, in units of the points' spacing; the trend stands for longer ones."""
_SHARES = np.concatenate([[0.0], np.logspace(-3.0, 7.0, 21)])
"""Ratios tried of the field's mean variance to the noise's."""
_PRIOR = np.where(_SHARES == 0.0, np.log(len(_SHARES) - 1.0), 0.0)
"""Log of their weights before the data: as likely no field at all as any."""
_REJECT = 3.5
"""Residuals of points left out beyond this many standard deviations are outliers."""
_ROUGHNESS = 0.02
"""Height of details that no field of one correlation length describes, in units of the points' spacing: such points are
no outliers however small the noise."""
_OUTLIER_WEIGHT = 1e-6
_ROUNDS = 8
_QUADRIC = 24
"""Points from which on the trend is a quadric; it is a plane below."""
_FOOTPRINT = 0.75
"""Standard deviation of the weights under which slopes are a mean, in units of the points' spacing: that of the plane
through a dot and its neighbours, whatever pores there are between them."""


def _footprint() -> tuple[Array, Array]:
    """Return places (K, 2) and their weights (K, 6) in the height, the mean slopes along x and y and the mean second
    derivatives xx, xy and yy at the origin, by Gauss-Hermite quadrature.
    """
    t, w = np.polynomial.hermite_e.hermegauss(5)
    x, y = (a.ravel() for a in np.meshgrid(t, t))
    weight = np.outer(w, w).ravel() / w.sum() ** 2
    middle = np.where((x == 0.0) & (y == 0.0), 1.0, 0.0)
    derivatives = [weight * f for f in (x, y, x * x - 1, x * y, y * y - 1)]
    scales = _FOOTPRINT ** np.array([0, 1, 1, 2, 2, 2])
    return _FOOTPRINT * np.stack([x, y], axis=1), np.stack([middle, *derivatives], axis=1) / scales


_NODES, _FUNCTIONALS = _footprint()


@dataclass(frozen=True, eq=False)
class HeightFit:
    """A height field at the origin.

    Attributes:
        estimate: (3,) height [m] and slopes along x and y, means over a dot's neighbourhood.
        covariance: (3, 3) of the estimate.
        bending: (2, 2) second derivatives, means over a dot's neighbourhood [1/m].
        noise: Standard deviation of the inliers' heights [m].
        inliers: (N,) points that agree with the surface.
    """

    estimate: Array
    covariance: Array
    bending: Array
    noise: float
    inliers: Mask


@dataclass(frozen=True, eq=False)
class _Kernel:
    """Correlations of the field for one length: between points (N, N), of them with what is asked for at the origin
    (N, 6), and among that (6, 6).
    """

    among: Array
    to_origin: Array
    at_origin: Array


@dataclass(frozen=True, eq=False)
class _Field:
    """A kernel seen past the trend: there the M components of the heights are independent.

    Attributes:
        values: (M,) variance of each component in units of the field's.
        vectors: (N, M) the components in the weighted heights.
        heights: (M,) components of the heights.
        reach: (M, 6) correlation of each component with what the trend says wrongly at the origin.
        rest: (6, 6) variance of that, in units of the field's.
    """

    values: Array
    vectors: Array
    heights: Array
    reach: Array
    rest: Array


@dataclass(frozen=True, eq=False)
class _Trend:
    """The trend alone: weighted least squares.

    Attributes:
        hat: (N, 6) what each weighted height adds to what is asked for at the origin.
        outside: (N, M) orthonormal, what the trend cannot describe.
        parameters: Of the trend.
    """

    hat: Array
    outside: Array
    parameters: int


def fit_height(places: Array, heights: Array, weights: Array, inliers: Mask, spacing: float) -> HeightFit:
    """Return height and slopes of a surface at the origin.

    Args:
        places: (N, 2) x and y [m].
        heights: (N,) [m].
        weights: (N,) inverse variances of the heights up to a common factor, positive.
        inliers: (N,) points believed to begin with; from there those that the others do not predict are left out.
        spacing: Typical distance of neighbouring points [m].
    """
    xy = places / spacing
    kernels = [_kernel(xy, length) for length in _LENGTHS]
    tried: list[Mask] = []
    while True:
        tried.append(inliers)
        fit, residuals = _average(xy, heights, weights, inliers, kernels, _ROUGHNESS * spacing)
        # hyperparameters that outliers have inflated make all residuals small: the scale follows, within reason
        scale = np.clip(1.4826 * np.median(np.abs(residuals[inliers])), 0.3, 1.0)
        inliers = np.abs(residuals) <= _REJECT * scale
        if len(tried) == _ROUNDS or any((inliers == old).all() for old in tried) or 2 * inliers.sum() < len(xy):
            break
    units = np.array([1.0, 1 / spacing, 1 / spacing])
    covariance = fit.covariance * np.outer(units, units)
    return HeightFit(fit.estimate * units, covariance, fit.bending / spacing**2, fit.noise, fit.inliers)


def _kernel(xy: Array, length: float) -> _Kernel:
    """Return the correlations of a field whose correlation length is given in units of xy (N, 2)."""
    to_nodes, among_nodes = (_matern(_distances(a, _NODES), length) for a in (xy, _NODES))
    return _Kernel(
        _matern(_distances(xy, xy), length), to_nodes @ _FUNCTIONALS, _FUNCTIONALS.T @ among_nodes @ _FUNCTIONALS
    )


def _distances(a: Array, b: Array) -> Array:
    distances: Array = np.linalg.norm(a[:, None] - b, axis=2)
    return distances


def _matern(distance: Array, length: float) -> Array:
    """Matern's correlation of order 5/2: of surfaces that are twice differentiable."""
    r = np.sqrt(5.0) / length * distance
    correlation: Array = (1 + r + r * r / 3) * np.exp(-r)
    return correlation


def _average(
    xy: Array, heights: Array, nominal: Array, inliers: Mask, kernels: list[_Kernel], roughness: float
) -> tuple[HeightFit, Array]:
    """Average all lengths and shares by their likelihood.

    Returns the fit and, for each point, how far the others' prediction is off it in standard deviations (N,).
    """
    weights = np.where(inliers, 1.0, _OUTLIER_WEIGHT) * nominal
    root = np.sqrt(weights)
    trend = _take_trend(xy, root, int(inliers.sum()))
    freedom = max(int(inliers.sum()) - trend.parameters, 1)
    fields = [_past_trend(kernel, root, heights, trend) for kernel in kernels]
    flat = trend.hat.T @ (root * heights)
    parts = [_all_shares(field, flat, trend.hat.T @ trend.hat, freedom) for field in fields]
    log, means, covariances, noise = (np.concatenate(p) for p in zip(*parts, strict=True))
    probability = np.exp(log - log.max())
    probability /= probability.sum()
    estimate = probability @ means
    off = means - estimate
    covariance = np.einsum("k,kij->ij", probability, covariances + off[:, :, None] * off[:, None])
    bending = estimate[[[3, 4], [4, 5]]]
    fit = HeightFit(estimate[:3], covariance[:3, :3], bending, float(np.sqrt(probability @ noise)), inliers)
    best, share = divmod(int(np.argmax(log)), len(_SHARES))
    off, variance = _left_out(fields[best], _shares(fields[best])[share], weights, nominal)
    return fit, off / np.sqrt(variance * noise[np.argmax(log)] + roughness**2)


def _take_trend(xy: Array, root: Array, count: int) -> _Trend:
    x, y = xy.T
    plane = [np.ones_like(x), x, y]
    design = np.stack([*plane, x * x, x * y, y * y] if count >= _QUADRIC else plane, axis=1)
    p = design.shape[1]
    q, r = np.linalg.qr(root[:, None] * design, mode="complete")
    derivatives = np.diag([1.0, 1.0, 1.0, 2.0, 1.0, 2.0])[:p]
    return _Trend(q[:, :p] @ np.linalg.pinv(r[:p]).T @ derivatives, q[:, p:], p)


def _past_trend(kernel: _Kernel, root: Array, heights: Array, trend: _Trend) -> _Field:
    among = root[:, None] * kernel.among * root
    values, vectors = np.linalg.eigh(trend.outside.T @ among @ trend.outside)
    vectors = trend.outside @ vectors
    to_origin, pull = root[:, None] * kernel.to_origin, among @ trend.hat
    cross = trend.hat.T @ to_origin
    return _Field(
        np.maximum(values, 0.0),
        vectors,
        vectors.T @ (root * heights),
        vectors.T @ (to_origin - pull),
        kernel.at_origin - cross - cross.T + trend.hat.T @ pull,
    )


def _shares(field: _Field) -> Array:
    """Return the variances (S,) of the field that are tried, in units of the noise's."""
    return _SHARES / max(float(field.values.mean()), 1e-300)


def _all_shares(field: _Field, flat: Array, flat_covariance: Array, freedom: int) -> tuple[Array, Array, Array, Array]:
    """Return log likelihood (S,), estimate (S, 6), covariance (S, 6, 6) and noise variance (S,) for all shares."""
    shares = _shares(field)
    gain = 1.0 / (shares[:, None] * field.values + 1.0)
    noise = np.maximum((gain * field.heights**2).sum(axis=1) / freedom, 1e-18)
    log = _PRIOR + 0.5 * np.log(gain).sum(axis=1) - 0.5 * freedom * np.log(noise)
    means = flat + shares[:, None] * ((gain * field.heights) @ field.reach)
    known = np.einsum("mi,sm,mj->sij", field.reach, gain, field.reach)
    s = shares[:, None, None]
    return log, means, noise[:, None, None] * (flat_covariance + s * (field.rest - s * known)), noise


def _left_out(field: _Field, share: float, weights: Array, nominal: Array) -> tuple[Array, Array]:
    """Return how far each point is off the prediction of all others (N,) [m], and the variance of that (N,) in units of
    the noise's.
    """
    gain = 1.0 / (share * field.values + 1.0)
    precision = np.maximum((field.vectors**2) @ gain, 1e-15)
    off = (field.vectors @ (gain * field.heights)) / (precision * np.sqrt(weights))
    return off, np.maximum(1 / precision - 1, 0.0) / weights + 1 / nominal
