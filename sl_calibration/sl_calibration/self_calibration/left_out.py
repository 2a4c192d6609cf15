"""Errors of views that took no part in the fit: the honest measure, as training errors prove little."""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration import lens
from sl_calibration.self_calibration.bundle_adjustment import adjust
from sl_calibration.self_calibration.bundle_problem import Problem, State, camera_points
from sl_calibration.self_calibration.errors import SelfCalibrationError
from sl_calibration.self_calibration.outliers import drop_dots, drop_views
from sl_calibration.self_calibration.result import LeftOut
from sl_calibration.triangulation import camera_from_projector, triangulate
from sl_common import transforms

Array = NDArray[np.float64]

LEAST_VIEWS = 5
_FOLDS = 5


def left_out_errors(problem: Problem, state: State) -> LeftOut:
    """Fit without every fifth of the views in turn and measure that fifth against the fit."""
    count = len(problem.observations.names)
    if count < LEAST_VIEWS:
        return LeftOut()
    sums, numbers = np.zeros(4), np.zeros(4)
    for fold in range(_FOLDS):
        out = np.arange(count) % _FOLDS == fold
        try:
            squares, n = _measure(problem, state, out)
        except SelfCalibrationError:
            continue
        sums, numbers = sums + squares, numbers + n
    rms = np.sqrt(sums / np.where(numbers > 0, numbers, np.nan))
    return LeftOut(*(float(x) for x in rms))


def _measure(problem: Problem, state: State, out: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return sums of squares and numbers of the four errors of :class:`LeftOut` for the views ``out`` (V,)."""
    observations = problem.observations
    kept, _ = drop_views(observations, ~out, observations.pixels)
    displacement = problem.displacement
    if displacement is not None:
        displacement = displacement[~out[observations.view]]
    seen = np.bincount(kept.point, minlength=len(observations.dots)) > 0
    kept, points = drop_dots(kept, seen, state.points)
    fit = replace(
        problem,
        observations=kept,
        displacement=displacement,
        smooth=problem.smooth[seen] if problem.smooth is not None else None,
        noise=replace(problem.noise, camera=problem.noise.camera[~out]),
        trusted=problem.trusted[~out],
    )
    start = replace(state, points=points, base_from_flange=state.base_from_flange[~out])
    fitted = adjust(fit, start, iterations=6, tolerance=1e-5).state

    rest, _ = drop_views(observations, out, observations.pixels)
    rest, _ = drop_dots(rest, seen, state.points)
    camera = lens.with_parameters(problem.camera, fitted.camera)
    projector = lens.with_parameters(problem.projector, fitted.projector)
    predicted = replace(fitted, base_from_flange=rest.base_from_flange)
    _, in_camera = camera_points(predicted, rest)
    error = np.linalg.norm(camera.project(in_camera) - rest.pixels, axis=-1)
    sums, numbers = (
        np.array([np.nansum(error**2), 0.0, 0.0, 0.0]),
        np.array([np.isfinite(error).sum(), 0, 0, 0], dtype=float),
    )
    for i, pose in enumerate(rest.base_from_flange):
        mine = rest.view == i
        known, pixels = fitted.points[rest.point[mine]], rest.pixels[mine]
        extrinsics = camera_from_projector(pose, fitted.flange_from_camera, fitted.base_from_projector)
        result = triangulate(camera, projector, extrinsics, pixels, rest.projector_pixels[rest.point[mine]])
        found = transforms.apply(pose @ fitted.flange_from_camera, result.points)[result.valid]
        sums[1] += np.sum((found - known[result.valid]) ** 2)
        numbers[1] += result.valid.sum()
        difference = _camera_pose_error(known, camera.undistort(pixels), pose @ fitted.flange_from_camera)
        if difference is not None:
            sums[2:] += difference**2
            numbers[2:] += 1
    return sums, numbers


def _camera_pose_error(points: Array, normalised: Array, base_from_camera: Array) -> Array | None:
    """Return distance [m] and angle [rad] between the camera pose given and the one that the image itself shows."""
    if len(points) < 6:
        return None
    start = transforms.inverse(base_from_camera)
    rotation, _ = cv2.Rodrigues(start[:3, :3])
    rotation, translation = cv2.solvePnPRefineLM(
        points, normalised, np.eye(3), None, rotation.copy(), start[:3, 3:].copy()
    )
    seen = transforms.inverse(transforms.make(cv2.Rodrigues(rotation)[0], translation[:, 0]))
    delta = transforms.difference(base_from_camera, seen)
    return np.array([np.linalg.norm(delta[:3]), np.linalg.norm(delta[3:])])
