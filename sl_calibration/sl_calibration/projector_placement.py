"""The projector's pose in the base from a calibrated pair, and from where the arm held the camera meanwhile."""

import numpy as np
from numpy.typing import NDArray

from sl_common import transforms
from sl_common.calibration_files import PoseCalibration

Array = NDArray[np.float64]


def place_projector(
    base_from_flange: Array, flange_from_camera: PoseCalibration, camera_from_projector: PoseCalibration
) -> PoseCalibration:
    """Return base_from_projector with its covariance (the chain of frames of the paper's figure 5).

    Args:
        base_from_flange: (4, 4) while the pair was calibrated [m], taken as exact.
        flange_from_camera: The hand-eye transform.
        camera_from_projector: Of the pair.
    """
    base_from_camera = base_from_flange @ flange_from_camera.transform
    effects = (
        (base_from_flange, flange_from_camera, base_from_camera[:3, :3] @ camera_from_projector.transform[:3, 3]),
        (base_from_camera, camera_from_projector, np.zeros(3)),
    )
    covariance = np.zeros((6, 6))
    for frame, pose, lever in effects:
        effect = _effect(frame[:3, :3], lever)
        covariance += effect @ pose.covariance @ effect.T
    return PoseCalibration(base_from_camera @ camera_from_projector.transform, covariance)


def _effect(rotation: Array, lever: Array) -> Array:
    """Return what (6,) a perturbation does after ``rotation`` (3, 3) to the base, at the end of ``lever`` (3,) [m]."""
    effect = np.zeros((6, 6))
    effect[:3, :3] = effect[3:, 3:] = rotation
    effect[:3, 3:] = -transforms.skew(lever) @ rotation
    return effect
