"""Which flange poses to visit for a self-calibration, before anything about the camera's mounting is known.

First a few small motions of the flange around the start pose, along and about its own axes: they keep the scene in view
whatever the mounting. They give a first estimate of the hand-eye transform and of where the dots are; from then on the
camera orbits the dots, turned by large angles about several axes, which is what makes a calibration accurate.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration.consistency import check_pairs, motion_spread
from sl_calibration.self_calibration.initialise import translation_and_points
from sl_calibration.self_calibration.relative_motion import pair_rotations
from sl_calibration.self_calibration.views import View, flatten
from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_common.errors import StructuredLightError

Array = NDArray[np.float64]

SAMPLES_NEEDED = 6
"""Views for a first result; fewer than this are degenerate too easily."""

SAMPLES_ADVISED = 12


@dataclass(frozen=True, kw_only=True)
class MotionPlanOptions:
    """How far to move.

    Attributes:
        tilt: Largest tilt of the viewing direction while orbiting [rad].
        roll: Largest roll about the viewing direction while orbiting [rad].
        first_shift: Shift of the first small motions [m].
        first_turn: Turn of the first small motions [rad].
    """

    tilt: float = float(np.radians(22.0))
    roll: float = float(np.radians(60.0))
    first_shift: float = 0.03
    first_turn: float = float(np.radians(5.0))


@dataclass(frozen=True, eq=False)
class Estimate:
    """First estimate of the mounting and the scene.

    Attributes:
        flange_from_camera: (4, 4).
        target: (3,) middle of the dots in the base frame [m].
        depth_spread: (max - min) / mean of the distances from camera to dots over all views.
    """

    flange_from_camera: Array
    target: Array
    depth_spread: float


def first_estimate(views: Sequence[View], camera: CameraModel, centers: Array) -> Estimate | None:
    """Return a first estimate from views (linear solution only), or None where they do not give one yet."""
    if len(views) < 3:
        return None
    try:
        observations = flatten(views, centers)
        normalised = camera.undistort(observations.pixels)
        finite = np.asarray(np.isfinite(normalised).all(-1))
        observations, normalised = observations.select(finite), normalised[finite]
        focal = float(camera.matrix[0, 0])
        rotation, _ = check_pairs(pair_rotations(observations, normalised, focal), observations.names)
        linear = translation_and_points(observations, normalised, focal, rotation)
    except StructuredLightError:
        return None
    known = np.asarray(np.isfinite(linear.points).all(-1))
    eyes = (observations.base_from_flange @ linear.flange_from_camera)[:, :3, 3]
    used = known[observations.point]
    distance = np.linalg.norm(linear.points[observations.point[used]] - eyes[observations.view[used]], axis=-1)
    low, high = np.percentile(distance, [1, 99])
    return Estimate(
        linear.flange_from_camera, np.median(linear.points[known], axis=0), float((high - low) / distance.mean())
    )


def first_motions(start: Array, options: MotionPlanOptions | None = None, scale: float = 1.0) -> list[Array]:
    """Return flange poses (4, 4) around ``start``: small turns about all of its axes, each with a shift.

    ``scale`` reduces them where too many dots leave the image.
    """
    o = options or MotionPlanOptions()
    turns = np.array([[1, 0, 0], [-0.6, 0.8, 0], [0, -1, 0.4], [0, 0.5, 1.5], [0.8, 0.3, -1.5]])
    shifts = np.array([[0, 1, 0.3], [1, 0, -0.5], [-1, -0.4, 0], [0.5, -1, 0.6], [-0.5, 0.6, -0.6]])
    steps = np.hstack([shifts * o.first_shift, turns * o.first_turn]) * scale
    # Turned and shifted in the flange's own frame: the start pose on the left.
    return [start @ transforms.make(transforms.rotation_exp(s[3:]), s[:3]) for s in steps]


def orbit(
    start: Array, estimate: Estimate, options: MotionPlanOptions | None = None, scale: float = 1.0
) -> list[Array]:
    """Return flange poses (4, 4) from which the camera sees the dots from other sides, rolls and distances.

    The camera's pose at ``start`` is turned about the middle of the dots, so that they stay in the image.
    """
    o = options or MotionPlanOptions()
    camera = start @ estimate.flange_from_camera
    offset = estimate.target - camera[:3, 3]
    axis = offset / np.linalg.norm(offset)
    right, down = camera[:3, 0], camera[:3, 1]
    # Tilt about right and down, roll about the line of sight, distance.
    steps = (
        (1.0, 0.0, 0.0, 1.0),
        (0.0, 1.0, 0.5, 1.1),
        (-1.0, 0.0, 1.0, 0.95),
        (0.0, -1.0, -0.5, 1.0),
        (0.7, 0.7, -1.0, 1.1),
        (-0.7, 0.7, 0.0, 0.9),
        (0.7, -0.7, 0.5, 1.0),
        (-0.7, -0.7, -0.7, 1.1),
    )
    poses = []
    for about_right, about_down, about_sight, distance in steps:
        tilt = transforms.rotation_exp(scale * o.tilt * (about_right * right + about_down * down))
        roll = transforms.rotation_exp(scale * o.roll * about_sight * axis)
        turn = tilt @ roll
        position = estimate.target - (1 + scale * (distance - 1)) * (turn @ offset)
        goal = transforms.make(turn @ camera[:3, :3], position)
        poses.append(goal @ transforms.inverse(estimate.flange_from_camera))
    return poses


def next_pose(
    poses: Sequence[Array], estimate: Estimate | None, options: MotionPlanOptions | None = None
) -> Array | None:
    """Return the planned flange pose that lies farthest from those visited; None before the first sample.

    The first pose visited counts as the start.
    """
    if not poses:
        return None
    start = poses[0]
    planned = first_motions(start, options) if estimate is None else orbit(start, estimate, options)

    def distance(pose: Array) -> float:
        delta = transforms.difference(np.stack(poses), pose)
        return float(np.min(np.linalg.norm(delta[:, 3:], axis=-1) + np.linalg.norm(delta[:, :3], axis=-1)))

    return max(planned, key=distance)


@dataclass(frozen=True)
class Coverage:
    """How well a set of views covers what a calibration needs.

    Attributes:
        image: Share of the image covered by dots over all views, 0..1.
        rotation: Angle between the two best separated axes of rotation [rad].
        depth: (max - min) / mean of the distances to the dots; NaN: not known yet.
        message: What stands and what to do next.
    """

    image: float
    rotation: float
    depth: float
    message: str


def coverage(views: Sequence[View], camera: CameraModel | None, estimate: Estimate | None) -> Coverage:
    """Measure the coverage of views and say what is missing."""
    if not views:
        return Coverage(0.0, 0.0, float("nan"), "no samples yet: bring the dots into view and call ~/take_sample")
    image = 0.0
    if camera is not None:
        pixels = np.concatenate([view.pixels for view in views])
        cells = np.histogram2d(
            pixels[:, 0], pixels[:, 1], bins=(16, 12), range=((-0.5, camera.width - 0.5), (-0.5, camera.height - 0.5))
        )[0]
        image = float((cells > 0).mean())
    spread = motion_spread(np.stack([view.base_from_flange for view in views]))
    parts = [f"{len(views)} samples"]
    if len(views) < SAMPLES_NEEDED:
        parts.append(f"at least {SAMPLES_NEEDED} are needed, {SAMPLES_ADVISED} advised")
    if len(views) > 1 and spread.second < np.radians(5.0):
        parts.append(
            f"turned by {np.degrees(spread.first):.0f} deg about an axis, {np.degrees(spread.second):.1f} deg across:"
            " turn about other axes too"
        )
    elif len(views) > 1 and image < 0.5:
        parts.append(f"dots cover {100 * image:.0f} % of the image: bring them to its edges as well")
    elif SAMPLES_NEEDED <= len(views) < SAMPLES_ADVISED:
        parts.append(f"enough for a first result, {SAMPLES_ADVISED} are advised")
    elif len(views) >= SAMPLES_ADVISED:
        parts.append("enough: call ~/compute")
    return Coverage(image, spread.axes, estimate.depth_spread if estimate else float("nan"), "; ".join(parts))
