"""Standard deviations of all residuals, estimated from the adjustment itself, and an allowance for correlated errors.

Helmert's estimation of variance components: the sum of squares of a group of residuals over its redundancy, which is
the number of its residuals minus the share of the unknowns that it determines.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration.bundle_problem import Linearisation, Noise, Problem

Array = NDArray[np.float64]

LEAST_CAMERA = 0.01
LEAST_PROJECTOR = 0.01
"""Least standard deviations [px]: exact (simulated) pixels must not make the equations singular."""

MOST_ROBOT_NOISE = 30.0
"""The robot's noise is never taken for more than so many times its prior: poses must not come loose from the robot."""

_LAG = 10  # [dots] over which residuals may be correlated


@dataclass(frozen=True)
class RobotNoise:
    """Noise of the reported flange poses and how firmly it is believed.

    Attributes:
        position: Standard deviation per axis [m].
        rotation: Standard deviation per axis [rad].
        belief: Weight of these figures against the adjustment's own, as a number of residuals; inf: taken as they are.
    """

    position: float = 1e-4
    rotation: float = float(np.radians(0.02))
    belief: float = 3.0


def estimate(
    problem: Problem, lin: Linearisation, parameters: Array, dots: Array, cross: Array, robot: RobotNoise
) -> Noise:
    """Return the noise that the residuals of a plain least-squares adjustment show.

    Args:
        problem: The problem adjusted.
        lin: Its linearisation at the minimum.
        parameters: (P, P) covariance of the reduced parameters.
        dots: (K, 3, 3) covariances of the dots.
        cross: (K, P, 3) their covariances with the parameters.
        robot: Prior figures of the robot's noise.
    """
    layout, noise, observations = problem.layout, problem.noise, problem.observations
    projector = slice(6, layout.projector.stop)
    by_projector, by_point = lin.projector_common, lin.projector_point
    share_projector = float(
        np.einsum("kij,jl,kil->", by_projector, parameters[projector, projector], by_projector, optimize=True)
        + 2 * np.einsum("kij,kjl,kil->", by_projector, cross[:, projector], by_point, optimize=True)
        + np.einsum("kij,kjl,kil->", by_point, dots, by_point, optimize=True)
    )
    start = layout.view(0).start
    used = (np.diag(parameters)[start:].reshape(-1, 6) * lin.pose_slope**2).sum(0)
    share_position, share_rotation = float(used[:3].sum()), float(used[3:].sum())
    unknowns = layout.size + 3 * len(observations.dots)
    share_camera = unknowns - share_projector - share_position - share_rotation

    count_camera = 2 * len(observations.view)
    redundancy = max(1 - share_camera / count_camera, 1e-3)
    squares = (lin.camera_residual**2).sum(-1)
    per_view = np.bincount(observations.view, squares, layout.views)
    counts = 2 * np.bincount(observations.view, minlength=layout.views) * redundancy
    overall = per_view.sum() / max(counts.sum(), 1)
    # Views differ (distance, blur), but a view of a few dots says little by itself: 50 residuals of the others' mean.
    ratio = (per_view + 50 * overall) / (counts + 50)
    camera = np.maximum(noise.camera * np.sqrt(ratio), LEAST_CAMERA)

    left_projector = max(2 * len(observations.dots) - share_projector, 1.0)
    projector_sigma = noise.projector * np.sqrt((lin.projector_residual**2).sum() / left_projector)

    trusted = 3 * int(problem.trusted.sum())
    left = (max(trusted - share_position, 0.0), max(trusted - share_rotation, 0.0))
    return Noise(
        camera=camera,
        projector=max(float(projector_sigma), LEAST_PROJECTOR),
        position=_blend(noise.position, lin.pose_residual[:, :3], left[0], robot.position, robot.belief),
        rotation=_blend(noise.rotation, lin.pose_residual[:, 3:], left[1], robot.rotation, robot.belief),
        freedom=(left[0] + robot.belief, left[1] + robot.belief),
    )


def _blend(sigma: float, residual: Array, redundancy: float, prior: float, belief: float) -> float:
    if np.isinf(belief):
        return prior
    squares = sigma**2 * float((residual**2).sum())
    estimated = float(np.sqrt((squares + belief * prior**2) / (redundancy + belief)))
    return min(estimated, MOST_ROBOT_NOISE * prior)


def correlation_inflation(grid: NDArray[np.int64], group: NDArray[np.int64], residual: Array) -> float:
    """Return by how much correlated errors raise the variance of what is estimated from many residuals, at least 1.

    Errors of neighbouring dots are alike where shading, blur or an imperfect lens model causes them; then N residuals
    tell less than N independent ones. The factor is the sum of the residuals' autocorrelation over the pattern's grid.

    Args:
        grid: (M, 2) row and column of the dots.
        group: (M,) index of the view of each residual.
        residual: (M, 2) residuals, weighted.
    """
    rows, cols = grid.max(0) + 1
    size = (rows + _LAG, cols + _LAG)
    power, overlap = np.zeros((rows + _LAG, (cols + _LAG) // 2 + 1)), np.zeros((rows + _LAG, (cols + _LAG) // 2 + 1))
    for i in np.unique(group):
        chosen = group == i
        where = tuple(grid[chosen].T)
        mask = np.zeros(size)
        mask[where] = 1.0
        overlap += 2 * np.abs(np.fft.rfft2(mask)) ** 2
        for k in range(2):
            image = np.zeros(size)
            image[where] = residual[chosen, k] - residual[chosen, k].mean()
            power += np.abs(np.fft.rfft2(image)) ** 2
    covariance, pairs = np.fft.irfft2(power, size), np.fft.irfft2(overlap, size)
    lag = np.arange(-_LAG, _LAG + 1)
    window = np.ix_(lag, lag)
    if not covariance[0, 0] > 0:
        return 1.0
    correlation = covariance[window] / np.maximum(pairs[window], 1.0) / (covariance[0, 0] / pairs[0, 0])
    taper = np.clip(1 - np.hypot(lag[:, None], lag) / (_LAG + 1), 0, None)
    return max(1.0, float((taper * correlation)[pairs[window] > 10].sum()))


def inflate(problem: Problem, lin: Linearisation) -> tuple[Problem, float, float]:
    """Return the problem with camera and projector noise raised for correlated errors, and the two variance factors."""
    observations = problem.observations
    camera = correlation_inflation(observations.dots[observations.point], observations.view, lin.camera_residual)
    projector = correlation_inflation(
        observations.dots, np.zeros(len(observations.dots), dtype=np.int64), lin.projector_residual
    )
    noise = replace(
        problem.noise,
        camera=problem.noise.camera * np.sqrt(camera),
        projector=problem.noise.projector * np.sqrt(projector),
    )
    return replace(problem, noise=noise), camera, projector


def robust_scale(index: NDArray[np.int64], length: Array, count: int) -> Array:
    """Return (count,) standard deviations per axis of 2-D residuals of given length (M,), from the median per group."""
    overall = float(np.median(length)) / 1.1774 if len(length) else 1.0
    out = np.full(count, overall)
    for i in range(count):
        mine = length[index == i]
        if len(mine) >= 20:
            out[i] = np.median(mine) / 1.1774
    return np.maximum(out, LEAST_CAMERA)
