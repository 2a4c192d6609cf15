"""Rejecting wrong codes, wrong dots and wrong flange poses while the bundle adjustment goes on."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration import consistency
from sl_calibration.self_calibration.bundle_adjustment import adjust
from sl_calibration.self_calibration.bundle_problem import Problem, State
from sl_calibration.self_calibration.effects import with_centroids
from sl_calibration.self_calibration.errors import InconsistentPosesError, TooFewViewsError
from sl_calibration.self_calibration.outliers import (
    drop_dots,
    drop_views,
    heavy_tails,
    outlier_pose,
    reprojection_errors,
    right_observations,
)
from sl_calibration.self_calibration.views import Observations


def reject(problem: Problem, state: State, *, first: bool = False) -> tuple[Problem, State]:
    """Drop observations off by more than four standard deviations of their view, and dots with less than two left."""
    observations = problem.observations
    in_camera, in_projector = reprojection_errors(problem, state)
    right = right_observations(observations.view, in_camera, len(observations.names), least=2.0 if first else 0.2)
    # Before the first adjustment dots come from the cameras alone; later they are drawn to the projector's rays.
    limit = max(5 * float(np.median(in_projector)) / 1.1774, 3.0) if first else 6 * problem.projector_sigma
    observations = observations.select(right & (in_projector < limit)[observations.point])
    # A dot of a single view has nothing but the epipolar line to show that its code is right.
    seen = np.bincount(observations.point, minlength=len(observations.dots)) > (0 if first else 1)
    observations, points = drop_dots(observations, seen, state.points)
    _check_views_left(observations)
    return _changed(problem, replace(state, points=points), observations)


def _changed(problem: Problem, state: State, observations: Observations) -> tuple[Problem, State]:
    """Put other observations into a problem, with the displacements of their centroids."""
    modelled = problem.displacement is not None
    problem = replace(problem, observations=observations, displacement=None, smooth=None)
    return (with_centroids(problem, state) if modelled else problem), state


def _check_views_left(observations: Observations) -> None:
    count = np.bincount(observations.view, minlength=len(observations.names))
    for name, n in zip(observations.names, count, strict=True):
        if n < 6:
            raise InconsistentPosesError(
                f"{name}: only {n} of its dots agree with the other views: the image belongs to another scene or pose;"
                " leave it out"
            )


def adjust_robustly(problem: Problem, state: State, warnings: list[str]) -> tuple[Problem, State, float]:
    """Adjust with a Huber loss, reject wrong codes and, one at a time, flange poses that do not fit.

    Also returns the share of errors between four and ten standard deviations.
    """
    tails = 0.0
    for attempt in range(len(problem.observations.names)):
        state = adjust(problem, state, iterations=30, tolerance=1e-6).state
        before = len(problem.observations.view)
        tails = max(tails, heavy_tails(problem.observations.view, reprojection_errors(problem, state)[0]))
        problem, state = reject(problem, state)
        outlier = outlier_pose(problem, state)
        if outlier is not None:
            keep = np.arange(len(problem.observations.names)) != outlier.view
            if keep.sum() < consistency.LEAST_VIEWS or attempt > len(problem.observations.names) / 2:
                raise InconsistentPosesError(outlier.sentence)
            warnings.append(f"left out: {outlier.sentence}")
            problem, state = _without_views(problem, state, keep)
            consistency.check_motion(problem.observations.base_from_flange)
        elif before - len(problem.observations.view) < 1e-3 * before:
            break
    return problem, state, tails


def _without_views(problem: Problem, state: State, keep: NDArray[np.bool_]) -> tuple[Problem, State]:
    observations, _ = drop_views(problem.observations, keep, problem.observations.pixels)
    seen = np.bincount(observations.point, minlength=len(observations.dots)) > 0
    observations, points = drop_dots(observations, seen, state.points)
    if len(observations.names) < consistency.LEAST_VIEWS:
        raise TooFewViewsError(f"{len(observations.names)} views are left after outliers: add views")
    noise = replace(problem.noise, camera=problem.noise.camera[keep])
    problem = replace(problem, noise=noise, trusted=problem.trusted[keep])
    return _changed(problem, replace(state, points=points, base_from_flange=state.base_from_flange[keep]), observations)
