"""Wrong codes and wrong flange poses: found, dropped and named. Also the bookkeeping of dropping views and dots."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration import lens
from sl_calibration.self_calibration.bundle_problem import Problem, State, camera_points
from sl_calibration.self_calibration.initialise import LinearSolution, translation_and_points
from sl_calibration.self_calibration.noise_model import robust_scale
from sl_calibration.self_calibration.views import Observations
from sl_calibration.triangulation import camera_from_projector, triangulate
from sl_common import transforms
from sl_common.cameras import CameraModel

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

PLAUSIBLE = 10.0
"""A view whose dots lie within this median distance [px] of where its pose puts them is left to the adjustment."""

POSE_THRESHOLD = 5.0
"""A flange pose off by more than this many standard deviations (robustly estimated) is an outlier."""


def drop_views(observations: Observations, keep: BoolArray, values: Array) -> tuple[Observations, Array]:
    """Keep the views where ``keep`` (V,) is true; ``values`` (M, ...) are reduced alike. Dots stay."""
    chosen = keep[observations.view]
    renumber = np.cumsum(keep) - 1
    names = tuple(name for name, k in zip(observations.names, keep, strict=True) if k)
    reduced = Observations(
        names,
        observations.base_from_flange[keep],
        renumber[observations.view[chosen]],
        observations.point[chosen],
        observations.pixels[chosen],
        observations.dots,
        observations.projector_pixels,
    )
    return reduced, values[chosen]


def drop_dots(observations: Observations, keep: BoolArray, points: Array) -> tuple[Observations, Array]:
    """Keep the dots where ``keep`` (K,) is true, with their observations; ``points`` (K, 3) are reduced alike."""
    chosen = keep[observations.point]
    renumber = np.cumsum(keep) - 1
    reduced = Observations(
        observations.names,
        observations.base_from_flange,
        observations.view[chosen],
        renumber[observations.point[chosen]],
        observations.pixels[chosen],
        observations.dots[keep],
        observations.projector_pixels[keep],
    )
    return reduced, points[keep]


def right_observations(
    view: IntArray, error: Array, views: int, *, threshold: float = 4.0, least: float = 2.0
) -> BoolArray:
    """Tell which observations (M,) have an error [px] below ``threshold`` standard deviations of their view.

    ``least`` [px] is the smallest threshold; observations without a known error (NaN) count as right.
    """
    known = np.isfinite(error)
    scale = robust_scale(view[known], error[known], views)
    limit = np.maximum(threshold * scale, least)
    return ~known | (np.where(known, error, 0.0) <= limit[view])


def heavy_tails(view: IntArray, error: Array) -> float:
    """Return the share of errors (M,) [px] at four to ten standard deviations of their view; wrong codes lie beyond."""
    ratio = error / robust_scale(view, error, int(view.max()) + 1)[view]
    return float(np.mean((ratio > 4) & (ratio < 10)))


def reprojection_errors(problem: Problem, state: State) -> tuple[Array, Array]:
    """Return the errors (M,) in the camera and (K,) in the projector [px]; inf behind either."""
    observations = problem.observations
    _, in_camera = camera_points(state, observations)
    in_projector = transforms.apply(transforms.inverse(state.base_from_projector), state.points)
    seen, _, _ = lens.project(problem.camera.distortion_model, state.camera, in_camera)
    if problem.displacement is not None:
        seen = seen + state.variance * problem.displacement
    shown, _, _ = lens.project(problem.projector.distortion_model, state.projector, in_projector)
    camera_error = np.linalg.norm(observations.pixels - seen, axis=-1)
    projector_error = np.linalg.norm(observations.projector_pixels - shown, axis=-1)
    return np.where(in_camera[:, 2] > 0, camera_error, np.inf), np.where(
        in_projector[:, 2] > 0, projector_error, np.inf
    )


def complete_points(
    observations: Observations,
    linear: LinearSolution,
    found: BoolArray,
    camera: CameraModel,
    projector: CameraModel,
    base_from_projector: Array,
) -> Array:
    """Return points (K, 3): those found between views, others from a camera and the projector; NaN where neither."""
    points = np.where(found[:, None], linear.points, np.nan)
    rest = ~found[observations.point]
    single = np.full((len(observations.view), 3), np.nan)
    for i, pose in enumerate(observations.base_from_flange):
        mine = np.flatnonzero(rest & (observations.view == i))
        if len(mine) == 0:
            continue
        extrinsics = camera_from_projector(pose, linear.flange_from_camera, base_from_projector)
        projected = observations.projector_pixels[observations.point[mine]]
        result = triangulate(camera, projector, extrinsics, observations.pixels[mine], projected)
        single[mine] = transforms.apply(pose @ linear.flange_from_camera, result.points)
    order = np.flatnonzero(np.isfinite(single).all(-1))
    for k in np.unique(observations.point[order]):
        points[k] = np.median(single[order[observations.point[order] == k]], axis=0)
    return points


def reinstate(
    observations: Observations, normalised: Array, focal: float, hand_eye: Array, good: BoolArray
) -> BoolArray:
    """Return ``good`` (V,) with those views added whose dots, known from the good views, lie where their pose says.

    The essential matrix of two views with few common dots can be wrong where both poses are right.
    """
    kept, kept_normalised = drop_views(observations, good, normalised)
    linear = translation_and_points(kept, kept_normalised, focal, hand_eye)
    out = good.copy()
    for i in np.flatnonzero(~good):
        mine = np.flatnonzero((observations.view == i) & np.isfinite(linear.points[observations.point]).all(-1))
        camera_from_base = transforms.inverse(observations.base_from_flange[i] @ linear.flange_from_camera)
        seen = transforms.apply(camera_from_base, linear.points[observations.point[mine]])
        if len(mine) == 0:
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            error = focal * np.linalg.norm(seen[:, :2] / seen[:, 2:] - normalised[mine], axis=-1)
        out[i] = np.median(np.where(seen[:, 2] > 0, error, np.inf)) < PLAUSIBLE
    return out


@dataclass(frozen=True)
class OutlierPose:
    """A view whose reported flange pose does not fit: its index and a sentence with the numbers."""

    view: int
    sentence: str


def outlier_pose(problem: Problem, state: State) -> OutlierPose | None:
    """Return the view whose flange pose is farthest off, where that is more than the others' noise explains."""
    reported = problem.observations.base_from_flange
    difference = np.abs(transforms.difference(reported, state.base_from_flange))
    position, rotation = difference[:, :3], difference[:, 3:]
    noise = problem.noise
    position_scale = max(noise.position, float(np.median(position)) / 0.6745)
    rotation_scale = max(noise.rotation, float(np.median(rotation)) / 0.6745)
    # Three axes at once: a chi distribution with three degrees of freedom, whose 1e-5 quantile is 5.
    off = np.hypot(
        np.linalg.norm(position, axis=-1) / position_scale, np.linalg.norm(rotation, axis=-1) / rotation_scale
    )
    worst = int(np.argmax(off))
    if off[worst] < POSE_THRESHOLD * np.sqrt(2):
        return None
    name = problem.observations.names[worst]
    return OutlierPose(
        worst,
        f"the pose of {name} does not fit its image: off by {1e3 * np.linalg.norm(position[worst]):.1f} mm and"
        f" {np.degrees(np.linalg.norm(rotation[worst])):.2f} deg, the others by {1e3 * position_scale:.2f} mm and"
        f" {np.degrees(rotation_scale):.3f} deg per axis",
    )
