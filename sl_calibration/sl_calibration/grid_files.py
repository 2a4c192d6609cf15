"""The results of the procedures with a grid as files of a calibration folder."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sl_calibration.camera_calibration import CameraCalibration, rms, root_mean_square
from sl_calibration.hand_eye import HandEye
from sl_calibration.projector_calibration import ProcamCalibration
from sl_calibration.projector_placement import place_projector
from sl_common.calibration_files import (
    CAMERA_FILE,
    HAND_EYE_KEY,
    PROJECTOR_FILE,
    PROJECTOR_POSE_FILE,
    PROJECTOR_POSE_KEY,
    PoseCalibration,
    provenance,
    save_camera,
    save_pose,
)

Array = NDArray[np.float64]

PAIR_FILE = "camera_from_projector.yaml"
PAIR_KEY = "camera_from_projector"


def save_camera_calibration(path: str | os.PathLike[str], result: CameraCalibration, *, name: str = "camera") -> Path:
    """Write a camera_info file with date, units, residuals, samples and uncertainty; returns its absolute path."""
    path = Path(path).expanduser().resolve()
    residuals = {
        "training_rms_px": rms(result.residuals),
        "left_out_rms_px": root_mean_square(result.left_out),
    }
    extra = provenance(samples=len(result.residuals), residuals=residuals) | {
        "model": result.parametrisation.model,
        "uncertainty_one_sigma": {name: entry["sigma"] for name, entry in result.parameters.items()},
    }
    save_camera(path, result.camera, name=name, extra=extra)
    return path


def save_procam_calibration(
    folder: str | os.PathLike[str],
    result: ProcamCalibration,
    *,
    base_from_flange: Array | None = None,
    hand_eye: PoseCalibration | None = None,
) -> list[Path]:
    """Write camera.yaml, projector.yaml and camera_from_projector.yaml; returns their absolute paths.

    With the flange's pose (4, 4) [m] during all captures and the hand-eye transform, projector_pose.yaml too.
    """
    folder = Path(folder).expanduser().resolve()
    samples = len(result.camera_residuals)
    rigid = {"rigid_fit_rms_mm": root_mean_square(result.rigid_fit)}
    for file, model, name, residuals, left_out, parameters in (
        (
            CAMERA_FILE,
            result.camera,
            "camera",
            result.camera_residuals,
            result.left_out_camera,
            result.camera_parameters,
        ),
        (
            PROJECTOR_FILE,
            result.projector,
            "projector",
            result.projector_residuals,
            result.left_out_projector,
            result.projector_parameters,
        ),
    ):
        errors = {"training_rms_px": rms(residuals), "left_out_rms_px": root_mean_square(left_out)} | rigid
        extra = provenance(samples=samples, residuals=errors) | {
            "uncertainty_one_sigma": {key: entry["sigma"] for key, entry in parameters.items()}
        }
        save_camera(folder / file, model, name=name, extra=extra)
    pose = PoseCalibration(
        result.camera_from_projector, result.pose_covariance, provenance(samples=samples, residuals=rigid)
    )
    save_pose(folder / PAIR_FILE, PAIR_KEY, pose)
    files = [folder / name for name in (CAMERA_FILE, PROJECTOR_FILE, PAIR_FILE)]
    if base_from_flange is not None and hand_eye is not None:
        extra = provenance(samples=samples, residuals={}) | {"method": "grid: flange pose, hand-eye transform, pair"}
        placed = replace(place_projector(base_from_flange, hand_eye, pose), extra=extra)
        save_pose(folder / PROJECTOR_POSE_FILE, PROJECTOR_POSE_KEY, placed)
        files.append(folder / PROJECTOR_POSE_FILE)
    return files


def save_hand_eye_calibration(path: str | os.PathLike[str], result: HandEye) -> Path:
    """Write hand_eye.yaml; returns its absolute path."""
    path = Path(path).expanduser().resolve()

    residuals = {
        "training_mean_mm": float(1e3 * result.position_error.mean()),
        "training_mean_deg": float(np.degrees(result.rotation_error.mean())),
        "left_out_mean_mm": float(1e3 * result.left_out_position.mean()),
        "left_out_mean_deg": float(np.degrees(result.left_out_rotation.mean())),
        "left_out_rms_mm": 1e3 * root_mean_square(result.left_out_position),
        "left_out_rms_deg": float(np.degrees(root_mean_square(result.left_out_rotation))),
    }
    extra = provenance(samples=len(result.rows), residuals=residuals) | {"time_offset_s": result.time_offset}
    save_pose(path, HAND_EYE_KEY, PoseCalibration(result.flange_from_camera, result.covariance, extra))
    return path
