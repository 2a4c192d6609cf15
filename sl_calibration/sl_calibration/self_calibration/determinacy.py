"""Is a result worth having? Refuses what the views leave undetermined and says which motion or scene to add."""

import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration.bundle_problem import Problem
from sl_calibration.self_calibration.consistency import motion_spread
from sl_calibration.self_calibration.errors import DegenerateMotionError, DegenerateSceneError
from sl_calibration.self_calibration.noise_model import RobotNoise
from sl_calibration.self_calibration.result import SelfCalibration

Array = NDArray[np.float64]

REFUSED_POSITION = 0.02
"""Standard deviation of the hand-eye position [m] along its worst direction from which on there is no result."""
REFUSED_ROTATION = np.radians(1.0)
REFUSED_FOCAL = 0.03
"""Relative standard deviation of the projector's focal length from which on there is no result."""
REFUSED_CENTRE = 0.05
"""Standard deviation of its principal point as a share of the focal length."""

FLAT = 0.003
"""Relief of the scene (RMS distance from its best plane) as a share of its extent below which it counts as a plane."""

WEAK = 0.1
"""Share of the above from which on a warning says what to add."""


def check_determined(result: SelfCalibration, problem: Problem, robot: RobotNoise) -> list[str]:
    """Return warnings about weakly determined unknowns.

    Raises DegenerateMotionError or DegenerateSceneError for unknowns that are not determined at all.
    """
    position, direction = _worst(result.hand_eye_covariance[:3, :3])
    rotation, _ = _worst(result.hand_eye_covariance[3:, 3:])
    focal = max(
        result.projector_sigma["fx"] / result.projector.matrix[0, 0],
        result.projector_sigma["fy"] / result.projector.matrix[1, 1],
    )
    centre = max(result.projector_sigma["cx"], result.projector_sigma["cy"]) / result.projector.matrix[0, 0]
    spread = motion_spread(problem.observations.base_from_flange)
    turn = (
        f"the flange turns by {np.degrees(spread.first):.0f} deg about one axis and {np.degrees(spread.second):.1f} deg"
        " across it (RMS between views)"
    )
    axis = " ".join(f"{x:.2f}" for x in direction)
    extent = float(np.linalg.norm(result.points.std(axis=0)))
    depth = f"the dots lie within {1e3 * result.scene_depth:.1f} mm (RMS) of one plane, over {1e3 * extent:.0f} mm"
    if position > REFUSED_POSITION or rotation > REFUSED_ROTATION:
        raise DegenerateMotionError(
            f"the hand-eye transform is not determined: {1e3 * position:.0f} mm along ({axis}) of the flange and"
            f" {np.degrees(rotation):.2f} deg (one sigma); {turn}; add views turned by 20 deg or more about"
            " two different axes"
        )
    if focal > REFUSED_FOCAL or centre > REFUSED_CENTRE or result.scene_depth < FLAT * extent:
        raise DegenerateSceneError(
            f"the projector is not determined: focal length to {100 * focal:.1f} %, principal point to"
            f" {centre * result.projector.matrix[0, 0]:.0f} px (one sigma); {depth}; put objects of different height"
            " into the projector's light"
        )
    warnings = []
    if result.noise.position > 3 * robot.position or result.noise.rotation > 3 * robot.rotation:
        warnings.append(
            f"flange poses are noisier than stated: {1e3 * result.noise.position:.2f} mm and"
            f" {np.degrees(result.noise.rotation):.3f} deg per axis instead of {1e3 * robot.position:.2f} mm and"
            f" {np.degrees(robot.rotation):.3f} deg"
        )
    if position > WEAK * REFUSED_POSITION or rotation > WEAK * REFUSED_ROTATION:
        warnings.append(
            f"hand-eye transform uncertain by {1e3 * position:.1f} mm along ({axis}) of the flange and"
            f" {np.degrees(rotation):.3f} deg (one sigma); {turn}: add views turned about the other axes"
        )
    if focal > WEAK * REFUSED_FOCAL or centre > WEAK * REFUSED_CENTRE:
        warnings.append(
            f"projector uncertain: focal length {100 * focal:.2f} %, principal point"
            f" {centre * result.projector.matrix[0, 0]:.1f} px (one sigma); {depth}: more relief in the scene helps"
        )
    return warnings


def _worst(covariance: Array) -> tuple[float, Array]:
    """Return the largest standard deviation of a covariance (3, 3) and its direction."""
    values, vectors = np.linalg.eigh(covariance)
    return float(np.sqrt(max(values[-1], 0.0))), vectors[:, -1]
