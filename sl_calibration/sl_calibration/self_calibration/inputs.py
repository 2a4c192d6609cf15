"""Input files of the offline commands: the motion as JSON, the correspondences as CSV."""

import csv
import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration.views import LEAST_DOTS, View
from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Motion:
    """A recorded motion.

    Attributes:
        camera: Camera model.
        images: Image name of each view, as the file gives it.
        base_from_flange: (V, 4, 4) [m].
        position_sigma: Noise of the reported flange positions per axis [m]; None: not stated.
        rotation_sigma: Noise of the reported flange rotations per axis [rad]; None: not stated.
    """

    camera: CameraModel
    images: tuple[str, ...]
    base_from_flange: Array
    position_sigma: float | None
    rotation_sigma: float | None


def load_motion(path: str | os.PathLike[str]) -> Motion:
    """Read a motion file: ``camera``, ``distortion_model``, ``views`` with image and pose, optionally ``robot_noise``.

    Raises InvalidInputError naming the file and the entry that is missing or wrong.
    """
    try:
        data = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InvalidInputError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise InvalidInputError(f"{path}: not valid JSON: {error}") from None
    try:
        noise = data.get("robot_noise") or {}
        poses = []
        for view in data["views"]:
            pose = np.array(view["base_from_flange"], dtype=np.float64)
            if pose.shape != (4, 4) or not np.all(np.isfinite(pose)):
                raise InvalidInputError(
                    f"{view['image']}: base_from_flange must be a finite 4x4 matrix, got {pose.shape}"
                )
            poses.append(pose)
        return Motion(
            camera=_camera(data["camera"], data.get("distortion_model")),
            images=tuple(str(view["image"]) for view in data["views"]),
            base_from_flange=np.array(poses).reshape(-1, 4, 4),
            position_sigma=_sigma(noise, "mm", 1e-3),
            rotation_sigma=_sigma(noise, "deg", math.pi / 180),
        )
    except KeyError as error:
        raise InvalidInputError(f"{path}: entry {error} is missing") from None
    except (InvalidInputError, TypeError, ValueError, AttributeError) as error:
        raise InvalidInputError(f"{path}: {error}") from None


def _sigma(noise: dict[str, Any], key: str, unit: float) -> float | None:
    if noise.get(key) is None:
        return None
    value = float(noise[key])
    if not (math.isfinite(value) and value >= 0):
        raise InvalidInputError(f"robot_noise.{key} must not be negative, got {noise[key]}")
    return value * unit


def _camera(entry: dict[str, Any], model: str | None) -> CameraModel:
    matrix = np.array(
        [[entry["fx"], 0.0, entry["cx"]], [0.0, entry["fy"], entry["cy"]], [0.0, 0.0, 1.0]], dtype=np.float64
    )
    size = int(entry["width"]), int(entry["height"])
    pers_f = entry.get("pers_f")
    # The model is named, or described by its formula: r_u = f sinh(r / f).
    name = "pers" if model is not None and ("pers" in model.lower() or "sinh" in model) else model
    if pers_f and name not in ("plumb_bob", "none"):
        # The file gives the constant in pixels, as the focal lengths; the model works in normalised coordinates.
        return CameraModel(*size, matrix, "pers", (float(pers_f) / matrix[0, 0],))
    if name == "pers":
        raise InvalidInputError("distortion_model is pers but camera.pers_f is missing")
    model = name
    if model == "plumb_bob":
        coefficients = entry.get("coefficients", entry.get("distortion_coefficients"))
        if coefficients is None:
            raise InvalidInputError("distortion_model is plumb_bob but camera.coefficients is missing")
        return CameraModel(*size, matrix, "plumb_bob", tuple(coefficients))
    if model in (None, "none"):
        if pers_f:
            raise InvalidInputError("distortion_model is none but camera.pers_f is given: say pers or remove it")
        return CameraModel(*size, matrix)
    raise InvalidInputError(f"distortion_model '{model}' is unknown: use none, pers or plumb_bob")


@dataclass(frozen=True, eq=False)
class Dots:
    """Correspondences of one image: row (N,), col (N,) int64, pixels (N, 2) float64 raw, confidence (N,)."""

    row: NDArray[np.int64]
    col: NDArray[np.int64]
    pixels: Array
    confidence: Array


def load_correspondences(path: str | os.PathLike[str]) -> Dots:
    """Read a CSV with the header ``row,col,x,y,confidence``; further columns are ignored, confidence may be missing.

    Raises InvalidInputError with the line for anything that is not a number.
    """
    try:
        with Path(path).open(encoding="utf-8", newline="") as file:
            lines = [line for line in csv.reader(file) if line and not line[0].lstrip().startswith("#")]
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInputError(f"{path}: cannot be read: {error}") from None
    header = [name.strip().lower() for name in lines[0]] if lines else []
    missing = [name for name in ("row", "col", "x", "y") if name not in header]
    if missing:
        raise InvalidInputError(f"{path}: header lacks {', '.join(missing)}; expected row,col,x,y,confidence")
    columns = [header.index(name) for name in ("row", "col", "x", "y")]
    confidence = header.index("confidence") if "confidence" in header else None
    values = np.empty((len(lines) - 1, 5))
    for i, line in enumerate(lines[1:]):
        try:
            values[i, :4] = [float(line[c]) for c in columns]
            values[i, 4] = float(line[confidence]) if confidence is not None else 1.0
            if not np.all(np.isfinite(values[i])) or values[i, 0] % 1 or values[i, 1] % 1:
                raise ValueError(f"not finite, or row or col not an integer: {','.join(line)}")
        except (ValueError, IndexError) as error:
            raise InvalidInputError(f"{path}: data line {i + 1}: {error}") from None
    return Dots(values[:, 0].astype(np.int64), values[:, 1].astype(np.int64), values[:, 2:4], values[:, 4])


def load_views(
    motion: Motion, folder: str | os.PathLike[str], *, min_confidence: float = 0.5, least_dots: int = LEAST_DOTS
) -> tuple[list[View], list[str]]:
    """Pair the poses of a motion with DIR/<image name>.csv; returns the views and one note per image left out.

    Images without file or with fewer than ``least_dots`` dots are left out. Raises InvalidInputError when two views
    name the same image or no image has a file.
    """
    names = [Path(image).stem for image in motion.images]
    repeated = sorted({name for name in names if names.count(name) > 1})
    if repeated:
        raise InvalidInputError(f"the motion names the image {', '.join(repeated)} more than once: one pose per image")
    views, notes = [], []
    for name, pose in zip(names, motion.base_from_flange, strict=True):
        path = Path(folder) / f"{name}.csv"
        if not path.exists():
            notes.append(f"{name}: no correspondences in {folder}")
            continue
        dots = load_correspondences(path)
        keep = dots.confidence >= min_confidence
        if keep.sum() < least_dots:
            notes.append(f"{name}: {int(keep.sum())} dots of confidence {min_confidence:g}, {least_dots} are needed")
            continue
        views.append(View(name, dots.row[keep], dots.col[keep], dots.pixels[keep], _orthonormal(pose)))
    if not views:
        found = len(list(Path(folder).glob("*.csv"))) if Path(folder).is_dir() else 0
        raise InvalidInputError(f"{folder}: no usable correspondences of {len(names)} images ({found} CSV files)")
    return views, notes


def _orthonormal(pose: Array) -> Array:
    """Return the pose with the nearest rotation, where it is one up to rounding; any other pose unchanged."""
    u, s, vt = np.linalg.svd(pose[:3, :3])
    if np.abs(s - 1).max() > 1e-3 or np.linalg.det(u @ vt) < 0:
        return pose
    return transforms.make(u @ vt, pose[:3, 3])
