"""Sparse bundle adjustment: Levenberg-Marquardt with all dots eliminated by the Schur complement."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from sl_calibration.self_calibration.bundle_problem import Layout, Linearisation, Problem, State, linearise, update
from sl_calibration.self_calibration.errors import SelfCalibrationError
from sl_calibration.self_calibration.initialise import sum_by

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations, split into reduced parameters (P) and dots (K).

    Attributes:
        parameters: (P, P).
        coupling: (K, P, 3).
        dots: (K, 3, 3).
        gradient: (P,), right-hand side.
        dot_gradient: (K, 3).
    """

    parameters: Array
    coupling: Array
    dots: Array
    gradient: Array
    dot_gradient: Array


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Result of an adjustment: the state, its cost, and whether the steps came to an end."""

    state: State
    cost: float
    converged: bool
    iterations: int


def normal_equations(problem: Problem, lin: Linearisation) -> Normal:
    """Assemble the normal equations J^T J and J^T r of a linearisation."""
    layout, observations = problem.layout, problem.observations
    count, size = len(observations.dots), layout.size
    common = np.concatenate([np.arange(6), np.arange(layout.camera.start, layout.variance.stop)])
    projector = np.arange(6, layout.projector.stop)

    parameters, gradient = np.zeros((size, size)), np.zeros(size)
    order = np.argsort(observations.view, kind="stable")
    bounds = np.searchsorted(observations.view[order], np.arange(layout.views + 1))
    block = np.concatenate([lin.camera_common, lin.camera_view], axis=-1)
    for i in range(layout.views):
        rows = order[bounds[i] : bounds[i + 1]]
        index = np.concatenate([common, np.arange(layout.view(i).start, layout.view(i).stop)])
        jacobian = block[rows].reshape(-1, len(index))
        parameters[np.ix_(index, index)] += jacobian.T @ jacobian
        gradient[index] += jacobian.T @ lin.camera_residual[rows].ravel()
    jacobian = lin.projector_common.reshape(-1, len(projector))
    parameters[np.ix_(projector, projector)] += jacobian.T @ jacobian
    gradient[projector] += jacobian.T @ lin.projector_residual.ravel()
    poses = np.arange(layout.view(0).start, size)
    parameters[poses, poses] += (lin.pose_slope**2).ravel()
    gradient[poses] += (lin.pose_slope * lin.pose_residual).ravel()
    parameters[layout.variance, layout.variance] += lin.variance_residual[1] ** 2
    gradient[layout.variance] += lin.variance_residual[0] * lin.variance_residual[1]

    coupling = np.zeros((count, size, 3))
    by_point = np.swapaxes(lin.camera_point, -1, -2)
    coupling[:, common] = sum_by(observations.point, np.swapaxes(by_point @ lin.camera_common, -1, -2), count)
    coupling[:, projector] = np.swapaxes(lin.projector_common, -1, -2) @ lin.projector_point
    view_rows = layout.view(0).start + 6 * observations.view[:, None] + np.arange(6)
    coupling[observations.point[:, None], view_rows] = np.swapaxes(lin.camera_view, -1, -2) @ lin.camera_point
    projector_by_point = np.swapaxes(lin.projector_point, -1, -2)
    dots = sum_by(observations.point, by_point @ lin.camera_point, count) + projector_by_point @ lin.projector_point
    dot_gradient = sum_by(observations.point, (by_point @ lin.camera_residual[:, :, None])[:, :, 0], count)
    dot_gradient += (projector_by_point @ lin.projector_residual[:, :, None])[:, :, 0]
    return Normal(parameters, coupling, dots, gradient, dot_gradient)


def reduce_normal(normal: Normal, damping: float = 0.0) -> tuple[Array, Array, Array]:
    """Eliminate the dots; returns the reduced matrix (P, P), right-hand side (P,) and the dots' inverses (K, 3, 3)."""
    count, size, _ = normal.coupling.shape
    dots = normal.dots.copy()
    diagonal = np.arange(3)
    dots[:, diagonal, diagonal] *= 1 + damping
    inverse = np.linalg.inv(dots)
    flat = np.swapaxes(normal.coupling, 0, 1).reshape(size, 3 * count)
    weighted = np.swapaxes(normal.coupling @ inverse, 0, 1).reshape(size, 3 * count)
    reduced = normal.parameters - weighted @ flat.T
    reduced[np.arange(size), np.arange(size)] += damping * np.diag(normal.parameters)
    return reduced, normal.gradient - weighted @ normal.dot_gradient.ravel(), np.asarray(inverse, dtype=np.float64)


def adjust(problem: Problem, state: State, *, iterations: int = 50, tolerance: float = 1e-9) -> Adjustment:
    """Minimise the cost of a problem from a state.

    Ends when a step lowers the cost by less than ``tolerance`` of it. Raises SelfCalibrationError when the normal
    equations cannot be solved at any damping.
    """
    damping, converged = 1e-4, False
    trial: Linearisation | None = None
    current = linearise(problem, state)
    iteration = 0
    for iteration in range(1, iterations + 1):  # noqa: B007 (reported)
        normal = normal_equations(problem, current)
        while damping < 1e8:
            try:
                reduced, right, inverse = reduce_normal(normal, damping)
                step = _solve(reduced, right)
            except (LinAlgError, np.linalg.LinAlgError):
                damping *= 10
                continue
            rest = normal.dot_gradient - np.einsum("kpi,p->ki", normal.coupling, step)
            candidate = update(problem, state, step, (inverse @ rest[:, :, None])[:, :, 0])
            trial = _try(problem, candidate)
            if trial is not None and trial.cost <= current.cost:
                break
            trial = None
            damping *= 10
        if trial is None:
            converged = True  # no step of any length lowers the cost: a minimum up to rounding
            break
        gain = (current.cost - trial.cost) / max(current.cost, 1e-300)
        state, current, trial = candidate, trial, None
        damping = max(damping / 10, 1e-12)
        if gain < tolerance:
            converged = True
            break
    if not np.isfinite(current.cost):
        raise SelfCalibrationError("the bundle adjustment diverged: check the camera's intrinsics and the pattern file")
    return Adjustment(state, current.cost, converged, iteration)


def _try(problem: Problem, state: State) -> Linearisation | None:
    """Linearise at a candidate, or None where it is not a possible state."""
    if state.projector[:2].min() <= 0 or state.camera[:2].min() <= 0:
        return None
    with np.errstate(all="ignore"):
        trial = linearise(problem, state)
    return trial if np.isfinite(trial.cost) else None


def _solve(matrix: Array, right: Array) -> Array:
    """Solve a symmetric positive definite system after scaling its diagonal to one (units differ by orders)."""
    diagonal = np.diag(matrix)
    if not np.all(diagonal > 0):
        raise LinAlgError("not positive definite")
    scale = 1 / np.sqrt(diagonal)
    return scale * cho_solve(cho_factor(matrix * scale[:, None] * scale, lower=True), scale * right)


def consider(layout: Layout, sigma: float, parameters: Array, dots: Array, cross: Array) -> tuple[Array, Array, Array]:
    """Pass on the uncertainty of the dots' variance, which was held fixed, to the covariances of :func:`covariance`."""
    k = layout.variance.start
    lever = parameters[:, k] / parameters[k, k]
    dot_lever = cross[:, k] / parameters[k, k]
    extra = sigma**2 - parameters[k, k]
    return (
        parameters + extra * np.outer(lever, lever),
        dots + extra * dot_lever[:, :, None] * dot_lever[:, None, :],
        cross + extra * lever[:, None] * dot_lever[:, None, :],
    )


def covariance(normal: Normal) -> tuple[Array, Array, Array]:
    """Return the marginal covariances of the reduced parameters (P, P) and the dots (K, 3, 3), and theirs (K, P, 3).

    Dots are marginalised out of the former and the parameters' uncertainty is included in the latter. Raises
    SelfCalibrationError when the normal equations are singular.
    """
    try:
        reduced, _, inverse = reduce_normal(normal)
        diagonal = np.diag(reduced)
        if not np.all(diagonal > 0):
            raise LinAlgError("not positive definite")
        scale = 1 / np.sqrt(diagonal)
        factor = cho_factor(reduced * scale[:, None] * scale, lower=True)
    except (LinAlgError, np.linalg.LinAlgError):
        raise SelfCalibrationError("the unknowns are not determined by these views") from None
    parameters = scale[:, None] * cho_solve(factor, np.diag(scale))
    parameters = (parameters + parameters.T) / 2
    lever = normal.coupling @ inverse
    cross = -(parameters @ lever)
    dots = inverse - np.swapaxes(lever, -1, -2) @ cross
    return parameters, dots, cross
