"""A self-calibration as the files of a calibration folder."""

import csv
import io
import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from sl_calibration.self_calibration import lens
from sl_calibration.self_calibration.result import SelfCalibration
from sl_common.calibration_files import (
    CAMERA_FILE,
    HAND_EYE_FILE,
    HAND_EYE_KEY,
    PROJECTOR_FILE,
    PROJECTOR_POSE_FILE,
    PROJECTOR_POSE_KEY,
    PoseCalibration,
    provenance,
    save_camera,
    save_pose,
)
from sl_common.errors import StructuredLightError
from sl_common.files import write_text, write_yaml

REPORT_FILE = "self_calibration.yaml"
POINTS_FILE = "points.csv"


def residuals(result: SelfCalibration) -> dict[str, float]:
    """Return the residuals that every file carries, units in the keys."""
    left_out = result.left_out
    return {
        "training_px": result.rms,
        "left_out_px": left_out.pixels,
        "left_out_points_mm": 1e3 * left_out.points,
        "left_out_camera_mm": 1e3 * left_out.position,
        "left_out_camera_deg": float(np.degrees(left_out.rotation)),
    }


def describe(result: SelfCalibration) -> str:
    """Return a result in one sentence."""
    hand_eye = np.sqrt(np.diag(result.hand_eye_covariance))
    projector = np.sqrt(np.diag(result.projector_pose_covariance))
    text = (
        f"{len(result.names)} views, {result.rms:.3f} px training and {result.left_out.pixels:.3f} px left-out error;"
        f" hand-eye to {1e3 * np.linalg.norm(hand_eye[:3]):.2f} mm and"
        f" {np.degrees(np.linalg.norm(hand_eye[3:])):.3f} deg,"
        f" projector to {1e3 * np.linalg.norm(projector[:3]):.2f} mm and"
        f" {np.degrees(np.linalg.norm(projector[3:])):.3f} deg (one sigma)"
    )
    return "; ".join([text, *result.warnings])


def save(result: SelfCalibration, folder: str | os.PathLike[str], *, pattern_id: str) -> list[Path]:
    """Write camera.yaml, projector.yaml, hand_eye.yaml, projector_pose.yaml, a report and the dots; all files or none.

    Everything is written beside the folder first and moved into it at the end. Returns the absolute paths. Raises
    StructuredLightError when the folder cannot be written.
    """
    folder = Path(folder).expanduser().resolve()
    common = provenance(samples=len(result.names), residuals=residuals(result))
    common["procedure"] = "self-calibration from known robot motion"
    names = lens.names(result.projector.distortion_model)
    free = [name for name in names if name in result.projector_sigma]
    start = 12
    block = slice(start, start + len(free))
    projector = {
        "pattern_id": pattern_id,
        "parameters": free,
        "sigma": [result.projector_sigma[name] for name in free],
        "covariance": result.covariance[block, block],
    }
    camera: dict[str, Any] = {"refined": bool(result.camera_sigma)}
    if result.camera_sigma:
        camera["sigma"] = result.camera_sigma
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder, prefix=".self_calibration-") as temporary:
            new = Path(temporary)
            save_camera(new / CAMERA_FILE, result.camera, name="camera", extra=common | camera)
            save_camera(new / PROJECTOR_FILE, result.projector, name="projector", extra=common | projector)
            hand_eye = PoseCalibration(result.flange_from_camera, result.hand_eye_covariance, common)
            pose = PoseCalibration(result.base_from_projector, result.projector_pose_covariance, common)
            save_pose(new / HAND_EYE_FILE, HAND_EYE_KEY, hand_eye)
            save_pose(new / PROJECTOR_POSE_FILE, PROJECTOR_POSE_KEY, pose)
            write_yaml(new / REPORT_FILE, common | _report(result))
            write_text(new / POINTS_FILE, _points(result))
            written = []
            for path in sorted(new.iterdir()):
                shutil.move(path, folder / path.name)
                written.append(folder / path.name)
    except OSError as error:
        raise StructuredLightError(f"{folder}: calibration cannot be written: {error.strerror or error}") from None
    return written


def _report(result: SelfCalibration) -> dict[str, Any]:
    noise = result.noise
    projector = [name for name in lens.names(result.projector.distortion_model) if name in result.projector_sigma]
    pose = ["x", "y", "z", "rx", "ry", "rz"]
    return {
        "views": {name: {"rms_px": float(rms)} for name, rms in zip(result.names, result.view_rms, strict=True)},
        "observations": result.observations,
        "rejected": result.rejected,
        "dots": len(result.points),
        "scene_depth_mm": 1e3 * result.scene_depth,
        "noise": {
            "camera_px": noise.camera,
            "projector_px": noise.projector,
            "flange_position_mm": 1e3 * noise.position,
            "flange_rotation_deg": float(np.degrees(noise.rotation)),
        },
        "variance_factor_of_correlated_errors": {"camera": result.inflation[0], "projector": result.inflation[1]},
        "warnings": result.warnings,
        "joint_parameters": [
            *(f"flange_from_camera.{p}" for p in pose),
            *(f"base_from_projector.{p}" for p in pose),
            *(f"projector.{p}" for p in projector),
            *(f"camera.{p}" for p in result.camera_sigma),
        ],
        "joint_covariance": result.covariance,
    }


def _points(result: SelfCalibration) -> str:
    """Dots that two views or more confirm, in the base frame [m], with their standard deviations."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["row", "col", "x", "y", "z", "sx", "sy", "sz", "views"])
    sigma = np.sqrt(np.maximum(np.diagonal(result.point_covariance, axis1=-2, axis2=-1), 0))
    for k in np.flatnonzero(result.point_views > 1):
        numbers = [f"{value:.6f}" for value in (*result.points[k], *sigma[k])]
        writer.writerow([*result.dots[k].tolist(), *numbers, int(result.point_views[k])])
    return text.getvalue()
