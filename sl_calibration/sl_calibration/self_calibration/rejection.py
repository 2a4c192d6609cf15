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
from sl_common import transforms

LEAST_RIGHT = 6
"""A view with fewer right dots than this is left out."""

_RAISES = 8


def reject(problem: Problem, state: State, warnings: list[str], *, first: bool = False) -> tuple[Problem, State]:
    """Drop observations off by more than four standard deviations of their view, dots with less than two left, and
    views with hardly any; such views are added to the warnings."""
    observations = problem.observations
    in_camera, in_projector = reprojection_errors(problem, state)
    right = right_observations(
        observations.view,
        in_camera,
        len(observations.names),
        threshold=6.0 if first else 4.0,
        least=2.0 if first else 0.2,
    )
    # Before the first adjustment dots come from the cameras alone; later they are drawn to the projector's rays.
    limit = max(5 * float(np.median(in_projector)) / 1.1774, 3.0) if first else 6 * problem.projector_sigma
    observations = observations.select(right & (in_projector < limit)[observations.point])
    # A dot of a single view has nothing but the epipolar line to show that its code is right.
    seen = np.bincount(observations.point, minlength=len(observations.dots)) > (0 if first else 1)
    observations, points = drop_dots(observations, seen, state.points)
    problem, state = _changed(problem, replace(state, points=points), observations)
    return _without_empty_views(problem, state, warnings)


def _changed(problem: Problem, state: State, observations: Observations) -> tuple[Problem, State]:
    """Put other observations into a problem, with the displacements of their centroids."""
    modelled = problem.displacement is not None
    problem = replace(problem, observations=observations, displacement=None, smooth=None)
    return (with_centroids(problem, state) if modelled else problem), state


def _without_empty_views(problem: Problem, state: State, warnings: list[str]) -> tuple[Problem, State]:
    """Leave out views with hardly any dot left; raises InconsistentPosesError where too few remain."""
    names = problem.observations.names
    count = np.bincount(problem.observations.view, minlength=len(names))
    empty = count < LEAST_RIGHT
    if not empty.any():
        return problem, state
    said = [
        f"{name}: only {n} of its dots agree with the other views: the image belongs to another scene or pose"
        for name, n in zip(names, count, strict=True)
        if n < LEAST_RIGHT
    ]
    if empty.sum() > 0.4 * len(names) or (~empty).sum() < consistency.LEAST_VIEWS:
        raise InconsistentPosesError("; ".join(said[:3]) + "; leave it out")
    warnings += [f"left out: {sentence}" for sentence in said]
    return _without_views(problem, state, ~empty)


def adjust_robustly(problem: Problem, state: State, warnings: list[str]) -> tuple[Problem, State, float]:
    """Adjust with a Huber loss, reject wrong codes and, one at a time, flange poses that do not fit.

    Also returns the share of errors between four and ten standard deviations.
    """
    tails = 0.0
    for attempt in range(len(problem.observations.names)):
        problem, state = _adjust_with_robot_noise(problem, state)
        before = len(problem.observations.view)
        tails = max(tails, heavy_tails(problem.observations.view, reprojection_errors(problem, state)[0]))
        problem, state = reject(problem, state, warnings)
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


def _adjust_with_robot_noise(problem: Problem, state: State) -> tuple[Problem, State]:
    """Adjust, and raise the robot's noise to what the flange poses show, before anything is called wrong.

    Poses that are held more firmly than they deserve push their errors into the dots, which would be rejected instead.
    """
    for _ in range(_RAISES):
        state = adjust(problem, state, iterations=30, tolerance=1e-6).state
        difference = np.abs(transforms.difference(problem.observations.base_from_flange, state.base_from_flange))
        noise = problem.noise
        position = float(np.median(difference[:, :3])) / 0.6745
        rotation = float(np.median(difference[:, 3:])) / 0.6745
        if position < 1.3 * noise.position and rotation < 1.3 * noise.rotation:
            break
        # What shows of a noise that was held down is less than it is: go on until it shows no more.
        noise = replace(
            noise, position=max(noise.position, 1.5 * position), rotation=max(noise.rotation, 1.5 * rotation)
        )
        problem = replace(problem, noise=noise)
    return problem, state


def _without_views(problem: Problem, state: State, keep: NDArray[np.bool_]) -> tuple[Problem, State]:
    observations, _ = drop_views(problem.observations, keep, problem.observations.pixels)
    seen = np.bincount(observations.point, minlength=len(observations.dots)) > 0
    observations, points = drop_dots(observations, seen, state.points)
    if len(observations.names) < consistency.LEAST_VIEWS:
        raise TooFewViewsError(f"{len(observations.names)} views are left after outliers: add views")
    noise = replace(problem.noise, camera=problem.noise.camera[keep])
    problem = replace(problem, noise=noise, trusted=problem.trusted[keep])
    return _changed(problem, replace(state, points=points, base_from_flange=state.base_from_flange[keep]), observations)
