"""Bundle adjustment over views of one rigid target: shared intrinsics and a pose for each view.

Levenberg-Marquardt on the normal equations, whose blocks come from central differences: one evaluation for a parameter
of all views at once. The noise of each sensor is learned from the residuals, and corners that are not where the target
should have them (paper that lifts, a misread corner) are left out.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from sl_common import transforms
from sl_common.errors import StructuredLightError

Array = NDArray[np.float64]
Prediction = Callable[[Array, Array], Array]
"""(shared parameters (S,), target points in the first sensor's frame (V, N, 3)) -> predicted pixels (V, N, D)."""

_CORNER_LIMIT = 5.0
_SINGLE_LIMIT = 8.0
_NOISE_FLOOR = 0.02


class BundleError(StructuredLightError):
    """The adjustment cannot be solved with these observations."""


class OddViewError(BundleError):
    """One view does not fit the others.

    Attributes:
        view: Its index.
    """

    def __init__(self, view: int, reason: str):
        super().__init__(
            f"view {view + 1} does not fit the others: {reason}; was it taken by another camera, of another board, or"
            " misread? Leave it out"
        )
        self.view = view
        self.reason = reason


@dataclass(frozen=True, eq=False)
class BundleState:
    """Unknowns of the adjustment.

    Attributes:
        shared: (S,) parameters of all views.
        poses: (V, 4, 4) sensor_from_target [m].
    """

    shared: Array
    poses: Array


@dataclass(frozen=True, eq=False)
class BundleProblem:
    """Observations and priors.

    Attributes:
        predict: The measurement model.
        target: (N, 3) points of the target [m].
        observed: (V, N, D) pixels; NaN: not observed.
        sigma: (D,) standard deviation of the observations [px].
        steps: (S,) steps of the differences; roughly the smallest change of each shared parameter that matters.
        prior_mean: (S,) of the shared parameters.
        prior_sigma: (S,); inf: free.
    """

    predict: Prediction
    target: Array
    observed: Array
    sigma: Array
    steps: Array
    prior_mean: Array
    prior_sigma: Array

    def of_views(self, views: NDArray[np.bool_]) -> "BundleProblem":
        """Return the problem with the views of a mask (V,) alone."""
        return replace(self, observed=self.observed[views])


@dataclass(frozen=True, eq=False)
class BundleResult:
    """Solution of the adjustment.

    Attributes:
        state: Unknowns at the minimum.
        residuals: (V, N, D) observed minus predicted [px]; NaN where not observed.
        cost: Half the sum of squares, residuals over sigma and priors.
        covariance: (S + 6 V, S + 6 V) of the shared parameters and the pose perturbations.
        leverage: (D,) sum over the observations of each channel of the share that the unknowns take (degrees of freedom
            used up), for unbiased noise estimates.
    """

    state: BundleState
    residuals: Array
    cost: float
    covariance: Array
    leverage: Array


def solve(problem: BundleProblem, start: BundleState, *, max_iterations: int = 60) -> BundleResult:
    """Minimise the squared residuals over sigma plus the priors.

    Raises BundleError when the start predicts nothing finite or the normal equations stay singular.
    """
    state = start
    residuals = _residuals(problem, state)
    cost = _cost(problem, state, residuals)
    if not np.isfinite(cost):
        raise BundleError("bundle adjustment: the start predicts points that cannot be seen; check the inputs' order")
    damping = 1e-4
    quiet = 0
    for _ in range(max_iterations):
        normal, gradient, _ = _normal_equations(problem, state, residuals)
        improved = False
        for _ in range(12):
            step = _solve_damped(normal, gradient, damping)
            width = len(state.shared)
            candidate = BundleState(
                state.shared + step[:width], transforms.perturb(state.poses, step[width:].reshape(-1, 6))
            )
            new_residuals = _residuals(problem, candidate)
            new_cost = _cost(problem, candidate, new_residuals)
            if new_cost <= cost:
                improved = True
                break
            damping *= 8
        if not improved:
            break
        decrease = (cost - new_cost) / max(cost, 1e-12)
        state, residuals, cost = candidate, new_residuals, new_cost
        damping = max(damping / 8, 1e-10)
        quiet = quiet + 1 if decrease < 1e-7 else 0
        if quiet >= 2:
            break
    normal, _, blocks = _normal_equations(problem, state, residuals)
    covariance = _inverse(normal)
    return BundleResult(state, residuals, float(cost), covariance, _leverage(blocks, covariance))


def solve_with_noise(
    problem: BundleProblem, start: BundleState, *, channels: tuple[slice, ...], rounds: int = 3
) -> tuple[BundleProblem, BundleResult]:
    """Solve and learn the noise of each group of channels from the residuals, with their degrees of freedom.

    Args:
        problem: Its sigma is the starting value.
        start: Unknowns to start from.
        channels: Groups of channels that share one noise, such as (slice(0, 2), slice(2, 4)).
        rounds: Number of solutions.
    """
    result = solve(problem, start)
    for _ in range(rounds - 1):
        problem = replace(problem, sigma=_noise(problem, result, channels))
        result = solve(problem, result.state)
    return problem, result


def without_outliers(problem: BundleProblem, result: BundleResult) -> BundleProblem:
    """Leave out corners that do not fit the target: NaN in ``observed``.

    A corner goes in every view when its residual over all views is five times that of the typical corner (the target is
    not flat there), and a single observation when it is eight times its typical residual.

    Raises OddViewError when a view would lose more than half of its corners.
    """
    scaled = result.residuals / problem.sigma
    single = np.sqrt(np.nansum(scaled**2, axis=-1))
    seen = np.isfinite(scaled).all(-1)
    single[~seen] = np.nan
    observed = problem.observed.copy()
    typical = max(float(np.nanmedian(single)), _NOISE_FLOOR / float(problem.sigma.max()))
    observed[np.nan_to_num(single) > _SINGLE_LIMIT * typical] = np.nan
    number = np.maximum(seen.sum(0), 1)
    corner = np.sqrt(np.nansum(np.where(seen, single, 0.0) ** 2, axis=0) / number)
    if len(scaled) > 1:
        observed[:, corner > _CORNER_LIMIT * max(float(np.median(corner[seen.any(0)])), typical / 2)] = np.nan
    _check_views(problem, observed)
    return replace(problem, observed=observed)


def _check_views(before: BundleProblem, observed: Array) -> None:
    """Raise OddViewError when a view lost more than half of its corners."""
    seen = np.isfinite(before.observed).all(-1).sum(1)
    kept = np.isfinite(observed).all(-1).sum(1)
    worst = int(np.argmin(kept / np.maximum(seen, 1)))
    if kept[worst] < 0.5 * seen[worst]:
        raise OddViewError(worst, f"{seen[worst] - kept[worst]} of its {seen[worst]} corners are far off")


def _residuals(problem: BundleProblem, state: BundleState) -> Array:
    return problem.observed - problem.predict(state.shared, transforms.apply(state.poses, problem.target))


def _cost(problem: BundleProblem, state: BundleState, residuals: Array) -> float:
    scaled = (residuals / problem.sigma)[np.isfinite(problem.observed)]
    if not np.all(np.isfinite(scaled)):
        return np.inf
    prior = (state.shared - problem.prior_mean) / problem.prior_sigma
    return float(0.5 * (scaled @ scaled + prior @ prior))


def _blocks(problem: BundleProblem, state: BundleState) -> tuple[Array, Array]:
    """Return d prediction / d shared (V, N, D, S) and / d pose (V, N, D, 6), over sigma, 0 where not observed."""
    points = transforms.apply(state.poses, problem.target)
    seen = np.isfinite(problem.observed)

    def difference(forward: Array, backward: Array, step: float) -> Array:
        return np.where(seen, (forward - backward) / (2 * step) / problem.sigma, 0.0)

    shared = np.empty((*seen.shape, len(state.shared)))
    for k, step in enumerate(problem.steps):
        delta = np.zeros_like(state.shared)
        delta[k] = step
        forward, backward = (problem.predict(state.shared + sign * delta, points) for sign in (1, -1))
        shared[..., k] = difference(forward, backward, step)
    poses = np.empty((*seen.shape, 6))
    reach = float(np.ptp(problem.target, axis=0).max())
    for k in range(6):
        step = 1e-5 * reach if k < 3 else 1e-5
        delta = np.zeros(6)
        delta[k] = step
        forward, backward = (
            problem.predict(
                state.shared, transforms.apply(transforms.perturb(state.poses, sign * delta), problem.target)
            )
            for sign in (1, -1)
        )
        poses[..., k] = difference(forward, backward, step)
    return shared, poses


def _normal_equations(
    problem: BundleProblem, state: BundleState, residuals: Array
) -> tuple[Array, Array, tuple[Array, Array]]:
    shared, poses = blocks = _blocks(problem, state)
    views, width = len(poses), shared.shape[-1]
    scaled = np.where(np.isfinite(residuals), residuals / problem.sigma, 0.0)
    normal = np.zeros((width + 6 * views, width + 6 * views))
    gradient = np.zeros(len(normal))
    normal[:width, :width] = np.einsum("vndi,vndj->ij", shared, shared, optimize=True)
    coupling = np.einsum("vndi,vndj->ivj", shared, poses, optimize=True).reshape(width, 6 * views)
    normal[:width, width:] = coupling
    normal[width:, :width] = coupling.T
    diagonal = np.einsum("vndi,vndj->vij", poses, poses, optimize=True)
    for k in range(views):
        at = width + 6 * k
        normal[at : at + 6, at : at + 6] = diagonal[k]
    gradient[:width] = np.einsum("vndi,vnd->i", shared, scaled)
    gradient[width:] = np.einsum("vndi,vnd->vi", poses, scaled).ravel()
    prior = 1 / problem.prior_sigma**2
    normal[np.arange(width), np.arange(width)] += prior
    gradient[:width] -= prior * (state.shared - problem.prior_mean)
    return normal, gradient, blocks


def _solve_damped(normal: Array, gradient: Array, damping: float) -> Array:
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-12))
    matrix = normal / np.outer(scale, scale)
    matrix[np.diag_indices_from(matrix)] += damping
    try:
        return cho_solve(cho_factor(matrix), gradient / scale) / scale
    except np.linalg.LinAlgError:
        return np.zeros_like(gradient)


def _inverse(normal: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-12))
    matrix = normal / np.outer(scale, scale)
    matrix[np.diag_indices_from(matrix)] += 1e-12
    try:
        return cho_solve(cho_factor(matrix), np.eye(len(matrix))) / np.outer(scale, scale)
    except np.linalg.LinAlgError:
        raise BundleError(
            "bundle adjustment: the views do not determine the unknowns; add views with the target tilted otherwise"
        ) from None


def _leverage(blocks: tuple[Array, Array], covariance: Array) -> Array:
    """Sum of the leverages of each channel's observations."""
    shared, poses = blocks
    width = shared.shape[-1]
    out = np.zeros(shared.shape[2])
    for k in range(len(poses)):
        index = np.r_[:width, width + 6 * k : width + 6 * (k + 1)]
        jacobian = np.concatenate([shared[k], poses[k]], axis=-1)
        out += np.einsum("ndi,ij,ndj->d", jacobian, covariance[np.ix_(index, index)], jacobian, optimize=True)
    return out


def _noise(problem: BundleProblem, result: BundleResult, channels: tuple[slice, ...]) -> Array:
    sigma = problem.sigma.copy()
    for group in channels:
        residuals = result.residuals[..., group]
        number = np.isfinite(residuals).sum()
        free = max(number - result.leverage[group].sum(), 0.1 * number, 1.0)
        sigma[group] = np.sqrt(np.nansum(residuals**2) / free)
    return np.maximum(sigma, _NOISE_FLOOR)
