"""colours.yaml: what a colour calibration says of the letters in the camera image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sl_common.errors import InvalidInputError
from sl_common.files import read_yaml


@dataclass(frozen=True)
class Colours:
    """rgb (A, 3) float64: mean camera values above black of each letter, in the pattern's order, R G B."""

    rgb: NDArray[np.float64]


def load_colours(path: str | Path) -> Colours:
    """Read colours.yaml: the list `letters`, each with `camera_rgb: [r, g, b]`.

    Raises InvalidInputError with the reason.
    """
    data = read_yaml(path)
    entries = data.get("letters")
    if not isinstance(entries, list) or not entries:
        raise InvalidInputError(f"{path}: no list 'letters'; make the file with the colour calibration")
    try:
        rgb = np.array([[float(value) for value in entry["camera_rgb"]] for entry in entries])
    except (KeyError, TypeError, ValueError):
        raise InvalidInputError(f"{path}: every entry of 'letters' needs camera_rgb: [r, g, b]") from None
    if rgb.shape[1:] != (3,) or not np.isfinite(rgb).all() or rgb.max(initial=0.0) <= 0:
        raise InvalidInputError(f"{path}: camera_rgb must be three finite numbers, above zero in one of them")
    return Colours(rgb)
