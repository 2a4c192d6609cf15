"""The files of a calibration folder: camera.yaml, projector.yaml, hand_eye.yaml, projector_pose.yaml.

Camera and projector use the camera_info format that camera_calibration writes; a Pers lens keeps its own model under
``pers`` beside the plumb_bob fit that other tools read. The two poses are 4x4 matrices in metres with a 6x6 covariance
(x y z rx ry rz; m, rad; convention of :func:`sl_common.transforms.perturb`).
"""

import os
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_common.errors import CalibrationFileError, InvalidInputError
from sl_common.files import read_yaml, write_yaml

CAMERA_FILE = "camera.yaml"
PROJECTOR_FILE = "projector.yaml"
HAND_EYE_FILE = "hand_eye.yaml"
PROJECTOR_POSE_FILE = "projector_pose.yaml"
COLOURS_FILE = "colours.yaml"

HAND_EYE_KEY = "flange_from_camera"
PROJECTOR_POSE_KEY = "base_from_projector"


@dataclass(frozen=True, eq=False)
class PoseCalibration:
    """A calibrated pose.

    Attributes:
        transform: (4, 4) parent_from_child [m].
        covariance: (6, 6) of x y z rx ry rz in the parent frame [m, rad]; zeros: unknown.
        extra: whatever else the file carries: date, units, residuals, samples.
    """

    transform: NDArray[np.float64]
    covariance: NDArray[np.float64] = field(default_factory=lambda: np.zeros((6, 6)))
    extra: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Calibration:
    """All that the triangulation needs: models of camera and projector, hand-eye transform and projector pose."""

    camera: CameraModel
    projector: CameraModel
    flange_from_camera: PoseCalibration
    base_from_projector: PoseCalibration


def provenance(*, samples: int, residuals: dict[str, float]) -> dict[str, Any]:
    """Return the entries that every calibration file carries: date (UTC), units, number of samples, residuals."""
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "units": "m, rad, px",
        "samples": samples,
        "residuals": residuals,
    }


def save_camera(
    path: str | os.PathLike[str], model: CameraModel, *, name: str = "camera", extra: dict[str, Any] | None = None
) -> None:
    """Write a camera or projector model in the camera_info format, with ``extra`` entries behind."""
    published = model.as_plumb_bob()
    matrix = model.matrix
    data: dict[str, Any] = {
        "image_width": model.width,
        "image_height": model.height,
        "camera_name": name,
        "camera_matrix": _matrix(matrix),
        "distortion_model": "plumb_bob",
        "distortion_coefficients": _matrix(np.array([published.coefficients])),
        "rectification_matrix": _matrix(np.eye(3)),
        "projection_matrix": _matrix(np.hstack([matrix, np.zeros((3, 1))])),
    }
    if model.distortion_model == "pers":
        data["pers"] = {"f": model.coefficients[0], "formula": "r_u = f sinh(r / f), normalised coordinates"}
    write_yaml(path, data | (extra or {}))


def load_camera(path: str | os.PathLike[str]) -> CameraModel:
    """Read a camera_info file; the Pers model where the file carries one.

    Raises CalibrationFileError naming the file and the key that is missing or wrong.
    """
    data = read_yaml(path)
    try:
        matrix = _read_matrix(data["camera_matrix"], (3, 3))
        width, height = int(data["image_width"]), int(data["image_height"])
        if "pers" in data:
            return CameraModel(width, height, matrix, "pers", (float(data["pers"]["f"]),))
        model = str(data["distortion_model"]) or "none"
        coefficients = tuple(float(c) for c in data["distortion_coefficients"]["data"])
        if model == "none" or not any(coefficients):
            return CameraModel(width, height, matrix)
        return CameraModel(width, height, matrix, model, coefficients)
    except KeyError as error:
        raise CalibrationFileError(f"{path}: key {error} is missing") from None
    except (TypeError, ValueError, InvalidInputError) as error:
        raise CalibrationFileError(f"{path}: {error}") from None


def save_pose(path: str | os.PathLike[str], key: str, pose: PoseCalibration) -> None:
    """Write a pose file; ``key`` is ``flange_from_camera`` or ``base_from_projector``."""
    write_yaml(path, {key: pose.transform, "covariance": pose.covariance} | pose.extra)


def load_pose(path: str | os.PathLike[str], key: str) -> PoseCalibration:
    """Read a pose file.

    Raises CalibrationFileError when the key is missing, the matrix is not rigid or the covariance not 6x6.
    """
    data = dict(read_yaml(path))
    if key not in data:
        raise CalibrationFileError(f"{path}: key '{key}' is missing")
    try:
        transform = np.array(data.pop(key), dtype=np.float64)
        covariance = np.array(data.pop("covariance", np.zeros((6, 6))), dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CalibrationFileError(f"{path}: '{key}' or its covariance is not a matrix of numbers: {error}") from None
    if not transforms.is_rigid(transform):
        raise CalibrationFileError(f"{path}: '{key}' is not a rigid 4x4 transform (rotation, translation, 0 0 0 1)")
    if covariance.shape != (6, 6) or not np.all(np.isfinite(covariance)):
        raise CalibrationFileError(f"{path}: covariance must be 6x6 and finite, got shape {covariance.shape}")
    return PoseCalibration(transform, covariance, data)


def load_hand_eye(folder: str | os.PathLike[str]) -> PoseCalibration:
    """Read flange_from_camera of a calibration folder."""
    return load_pose(Path(folder) / HAND_EYE_FILE, HAND_EYE_KEY)


def load_projector_pose(folder: str | os.PathLike[str]) -> PoseCalibration:
    """Read base_from_projector of a calibration folder."""
    return load_pose(Path(folder) / PROJECTOR_POSE_FILE, PROJECTOR_POSE_KEY)


def load_calibration(folder: str | os.PathLike[str]) -> Calibration:
    """Read a whole calibration folder; raises CalibrationFileError naming the first file that cannot be used."""
    folder = Path(folder)
    return Calibration(
        camera=load_camera(folder / CAMERA_FILE),
        projector=load_camera(folder / PROJECTOR_FILE),
        flange_from_camera=load_hand_eye(folder),
        base_from_projector=load_projector_pose(folder),
    )


def _matrix(values: NDArray[np.float64]) -> dict[str, Any]:
    return {"rows": values.shape[0], "cols": values.shape[1], "data": values.ravel().tolist()}


def _read_matrix(entry: dict[str, Any], shape: tuple[int, int]) -> NDArray[np.float64]:
    data = np.array(entry["data"], dtype=np.float64)
    if data.size != shape[0] * shape[1]:
        raise InvalidInputError(f"matrix with {data.size} numbers, expected {shape[0]}x{shape[1]}")
    return data.reshape(shape)
