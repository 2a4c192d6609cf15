"""What the commands share: image files."""

import re
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sl_common.errors import InvalidInputError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


def natural_order(path: Path) -> list[object]:
    """Sort key: numbers in names count as numbers, so that bit_2 comes before bit_10."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path.name)]


def read_image(path: Path) -> NDArray[np.uint8]:
    """Read an image as (H, W) or (H, W, 3) BGR uint8; 16 bit is reduced to 8. Raises InvalidInputError."""
    image = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    if image is None:
        reason = "cannot be read as an image" if path.exists() else "no such file"
        raise InvalidInputError(f"{path}: {reason}")
    if image.dtype == np.uint16:
        image = (image / 257.0).round()
    return np.asarray(image, dtype=np.uint8)


def images_in(folder: Path) -> list[Path]:
    """Return the image files of a folder in natural order. Raises InvalidInputError when there is no such folder or
    image."""
    if not folder.is_dir():
        raise InvalidInputError(f"{folder}: no such folder")
    files = sorted((f for f in folder.iterdir() if f.suffix.lower() in IMAGE_SUFFIXES), key=natural_order)
    if not files:
        raise InvalidInputError(f"{folder}: no images ({', '.join(IMAGE_SUFFIXES)}) in it")
    return files
