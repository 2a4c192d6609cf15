"""Writing of rendered sets, each file whole or not at all."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from sl_common.errors import StructuredLightError
from sl_common.files import atomic_path, write_text


def refuse_used(folder: Path) -> None:
    """Raise StructuredLightError when the folder already holds images."""
    if any((folder / "images").glob("*.png")):
        raise StructuredLightError(f"{folder} already holds images: choose a new folder")


def write_image(folder: Path, name: str, image: np.ndarray) -> None:
    """images/NAME.png of an image (H, W, 3) uint8 BGR."""
    ok, png = cv2.imencode(".png", image)
    if not ok:
        raise StructuredLightError(f"cannot encode image {name} of shape {image.shape}")
    with atomic_path(folder / "images" / f"{name}.png") as path:
        path.write_bytes(png.tobytes())


def write_truth(folder: Path, name: str, arrays: dict[str, np.ndarray], meta: dict[str, Any] | None = None) -> None:
    """truth/NAME.npz and, with meta, truth/NAME.json."""
    with atomic_path(folder / "truth" / f"{name}.npz") as path, path.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    if meta is not None:
        write_json(folder / "truth" / f"{name}.json", meta)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """A JSON file."""
    write_text(path, json.dumps(content, indent=1) + "\n")
