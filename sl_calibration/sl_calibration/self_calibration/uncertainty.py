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

Array = NDArray[np.float64]

_PARAMETERS = 6
_LEVEL = 0.95
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
    return Covariances(parameters + more_parameters, dots + more_dots)


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
