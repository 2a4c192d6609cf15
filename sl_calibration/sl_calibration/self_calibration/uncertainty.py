"""Covariances of a result, with the uncertainty of the noise itself passed on.

The robot's noise is known from a few dozen residuals only, and the hand-eye transform and the base frame hang on it. A
region drawn with an estimated standard deviation must be wider than with a known one, as Student's t is wider than the
normal distribution; for six parameters at once, as Hotelling's T^2 (6 F(6, n)) is wider than chi-square. Each variance
component is raised by that ratio at 95 %, and the covariances follow by the law of error propagation: weights stay what
they were, errors count with their raised variances.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import f as fisher

from sl_calibration.self_calibration.bundle_adjustment import consider, covariance, normal_equations
from sl_calibration.self_calibration.bundle_problem import Linearisation, Problem, State, linearise
from sl_calibration.self_calibration.initialise import sum_by

Array = NDArray[np.float64]

_PARAMETERS = 6
_LEVEL = 0.95
_BLOCK = 8
"""Side of the blocks of dots whose errors may be alike; farther apart they are not."""

_LEAST_BLOCKS = 12

LEAST_FREEDOM = 2.0
"""Degrees of freedom below which the factor grows no more: the views hardly tell the robot's noise then."""


@dataclass(frozen=True, eq=False)
class Covariances:
    """Covariances of the reduced parameters (P, P), in the order of the problem's layout, and of the dots (K, 3, 3)."""

    parameters: Array
    dots: Array


def quantile_factor(freedom: float) -> float:
    """Return by how much a variance known with so many degrees of freedom is raised: 6 F(0.95; 6, n) / chi2(0.95; 6).

    1 for infinitely many.
    """
    if np.isinf(freedom):
        return 1.0
    freedom = max(freedom, LEAST_FREEDOM)
    return float(_PARAMETERS * fisher.ppf(_LEVEL, _PARAMETERS, freedom) / chi2.ppf(_LEVEL, _PARAMETERS))


def covariances(problem: Problem, state: State) -> Covariances:
    """Return the covariances at the minimum of a problem."""
    lin = linearise(problem, state)
    found = covariance(normal_equations(problem, lin))
    parameters, dots, _ = consider(problem.layout, problem.considered, *found) if problem.considered else found
    more_parameters, more_dots = _of_uncertain_noise(problem, lin, found[0], found[2])
    parameters = parameters + more_parameters
    widening = np.ones(len(parameters))
    # Flange poses and the camera's intrinsics come from few dots of few blocks each: theirs stays as it is.
    shared = problem.layout.projector.stop
    observed = np.diag(_of_blocks(problem, lin, found[0]) + more_parameters)
    assumed = np.diag(found[0] + more_parameters)
    widening[:shared] = np.sqrt(np.maximum(observed / assumed, 1.0))[:shared]
    return Covariances(parameters * np.outer(widening, widening), dots + more_dots)


def _of_blocks(problem: Problem, lin: Linearisation, parameters: Array) -> Array:
    """Return the covariance (P, P) that the errors themselves show, blocks of neighbouring dots being independent.

    The sandwich estimate with clusters: errors of a surface's shading or of a lens are alike over many dots and in all
    views, which no white noise explains. The pose prior counts as it is.
    """
    layout, observations = problem.layout, problem.observations
    count = len(observations.dots)
    common = np.concatenate([np.arange(6), np.arange(layout.camera.start, layout.variance.stop)])
    start = layout.view(0).start
    # At the minimum the gradient by each dot is zero: what is left is that by the parameters.
    score = np.zeros((count, layout.size))
    residual = lin.camera_residual[:, :, None]
    by_common = (np.swapaxes(lin.camera_common, -1, -2) @ residual)[:, :, 0]
    score[:, common] = sum_by(observations.point, by_common, count)
    rows = start + 6 * observations.view[:, None] + np.arange(6)
    by_view = (np.swapaxes(lin.camera_view, -1, -2) @ residual)[:, :, 0]
    np.add.at(score, (observations.point[:, None], rows), by_view)
    by_projector = (np.swapaxes(lin.projector_common, -1, -2) @ lin.projector_residual[:, :, None])[:, :, 0]
    score[:, 6 : layout.projector.stop] += by_projector

    place = observations.dots // _BLOCK
    _, block = np.unique(place[:, 0] * 10_000 + place[:, 1], return_inverse=True)
    blocks = sum_by(block.reshape(-1), score, int(block.max()) + 1)
    if len(blocks) < _LEAST_BLOCKS:
        return parameters
    meat = blocks.T @ blocks * (len(blocks) / (len(blocks) - 1))
    poses = np.arange(start, layout.size)
    meat[poses, poses] += (lin.pose_slope**2).ravel()
    meat[layout.variance, layout.variance] += lin.variance_residual[1] ** 2
    return np.asarray(parameters @ meat @ parameters, dtype=np.float64)


def _of_uncertain_noise(problem: Problem, lin: Linearisation, parameters: Array, cross: Array) -> tuple[Array, Array]:
    """Return what is added to the covariances as the noise of the reported flange poses is itself uncertain."""
    start = problem.layout.view(0).start
    factors = np.repeat([quantile_factor(n) - 1 for n in problem.noise.freedom], 3)
    # C = N^-1 J^T J N^-1 summed over groups of residuals; of the poses J is diagonal.
    weight = (lin.pose_slope**2 * factors).ravel()
    by_poses = parameters[:, start:]
    dots_by_poses = cross[:, start:]
    return (
        (by_poses * weight) @ by_poses.T,
        np.swapaxes(dots_by_poses * weight[:, None], -1, -2) @ dots_by_poses,
    )
