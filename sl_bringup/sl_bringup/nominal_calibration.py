"""A calibration folder as an earlier calibration would have left it: nominal values with realistic errors."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sl_common import transforms
from sl_common.calibration_files import (
    CAMERA_FILE,
    HAND_EYE_FILE,
    HAND_EYE_KEY,
    PROJECTOR_FILE,
    PROJECTOR_POSE_FILE,
    PROJECTOR_POSE_KEY,
    Calibration,
    PoseCalibration,
    provenance,
    save_camera,
    save_pose,
)
from sl_common.cameras import CameraModel

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class CalibrationErrors:
    """Standard deviations of a calibration's errors.

    The defaults are those of a good self-calibration from a dozen views: 1.5 times the Cramer-Rao limit at
    0.1 px of noise. They are drawn independently; errors of a real calibration hang together and cancel in part.

    Attributes:
        hand_eye_position: Of each coordinate of flange_from_camera [m].
        hand_eye_rotation: Of each component of its rotation [rad].
        projector_position: Of each coordinate of base_from_projector [m].
        projector_rotation: Of each component of its rotation [rad].
        focal_length: Of focal lengths, camera and projector, relative [1].
        principal_point: Of each coordinate of the principal points [px].
    """

    hand_eye_position: float = 0.25e-3
    hand_eye_rotation: float = np.radians(0.01)
    projector_position: float = 0.3e-3
    projector_rotation: float = np.radians(0.008)
    focal_length: float = 7e-5
    principal_point: float = 0.15


def perturbed(true: Calibration, seed: int, errors: CalibrationErrors | None = None) -> Calibration:
    """Return a calibration with normally distributed errors, the same for the same seed."""
    errors = errors or CalibrationErrors()
    rng = np.random.default_rng(seed)
    hand_eye = np.repeat((errors.hand_eye_position, errors.hand_eye_rotation), 3)
    projector = np.repeat((errors.projector_position, errors.projector_rotation), 3)
    return Calibration(
        camera=_perturbed_camera(true.camera, errors, rng),
        projector=_perturbed_camera(true.projector, errors, rng),
        flange_from_camera=_perturbed_pose(true.flange_from_camera.transform, hand_eye, rng),
        base_from_projector=_perturbed_pose(true.base_from_projector.transform, projector, rng),
    )


def save(folder: Path, calibration: Calibration, *, note: str, pattern_id: str = "", date: str = "") -> None:
    """Write camera.yaml, projector.yaml, hand_eye.yaml and projector_pose.yaml.

    Args:
        folder: Where to.
        calibration: What.
        note: Where it comes from.
        pattern_id: Pattern that the calibration holds for; empty: any.
        date: Instead of the present time.
    """
    extra = provenance(samples=0, residuals={}) | {"note": note} | ({"date": date} if date else {})
    save_camera(folder / CAMERA_FILE, calibration.camera, name="camera", extra=extra)
    shown = {"pattern_id": pattern_id} if pattern_id else {}
    save_camera(folder / PROJECTOR_FILE, calibration.projector, name="projector", extra=extra | shown)
    for name, key, pose in (
        (HAND_EYE_FILE, HAND_EYE_KEY, calibration.flange_from_camera),
        (PROJECTOR_POSE_FILE, PROJECTOR_POSE_KEY, calibration.base_from_projector),
    ):
        save_pose(folder / name, key, PoseCalibration(pose.transform, pose.covariance, extra))


def _perturbed_pose(pose: Array, sigma: Array, rng: np.random.Generator) -> PoseCalibration:
    return PoseCalibration(transforms.perturb(pose, rng.normal(size=6) * sigma), np.diag(sigma**2))


def _perturbed_camera(model: CameraModel, errors: CalibrationErrors, rng: np.random.Generator) -> CameraModel:
    matrix = model.matrix.copy()
    matrix[[0, 1], [0, 1]] *= 1 + errors.focal_length * rng.normal()
    matrix[:2, 2] += errors.principal_point * rng.normal(size=2)
    return CameraModel(model.width, model.height, matrix, model.distortion_model, model.coefficients)
