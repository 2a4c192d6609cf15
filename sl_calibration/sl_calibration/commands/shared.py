"""What the commands share: running with one clear line on failure, a progress bar, image files."""

import argparse
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from sl_common.errors import InvalidInputError, StructuredLightError

Item = TypeVar("Item")

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


def run(
    parser: argparse.ArgumentParser, action: Callable[[argparse.Namespace], None], given: Sequence[str] | None
) -> int:
    """Parse and act; return the exit code: 0 done, 1 failed with one line on stderr (2, wrong usage, by argparse)."""
    args = parser.parse_args(given)
    try:
        action(args)
    except StructuredLightError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        print(f"error: {error.filename}: {error.strerror}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("error: interrupted, nothing was written", file=sys.stderr)
        return 1
    return 0


def progress(items: Iterable[Item], label: str) -> Iterable[Item]:
    """Iterate with a progress bar on a terminal once it takes more than two seconds."""
    return tqdm(items, desc=label, delay=2.0, disable=None, leave=False)


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
