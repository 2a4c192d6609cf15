"""Charts for the calibration of colours and intensities (section III.B): frames of known drive values."""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from pattern_gen.errors import ProjectionError

CHART_ROWS, CHART_COLS = 4, 7
CHANNELS = ("red", "green", "blue")
_LEVELS = (0, 140, 255)
_STEP = 15


def colour_chart_drives() -> NDArray[np.uint8]:
    """(28, 3) uint8: the drive values of the chart: three levels of each channel, and a dark grey."""
    return np.array([*product(_LEVELS, repeat=3), (70, 70, 70)], dtype=np.uint8)


def colour_chart_values(step: int) -> NDArray[np.uint8]:
    """(CHART_ROWS, CHART_COLS, 3) uint8: drive values of the patches of one frame.

    From frame to frame the values move on by one patch, so that after all frames every place has seen every value.

    Raises:
        ProjectionError: no such step.
    """
    drives = colour_chart_drives()
    if not 0 <= step < len(drives):
        raise ProjectionError(
            f"step {step} does not exist: the colour chart has {len(drives)} frames, 0 to {len(drives) - 1}"
        )
    return np.roll(drives, step, axis=0).reshape(CHART_ROWS, CHART_COLS, 3)


def colour_chart(width: int, height: int, step: int) -> NDArray[np.uint8]:
    """(height, width, 3) uint8 RGB frame of the colour chart."""
    values = colour_chart_values(step)
    row = np.arange(height) * CHART_ROWS // height
    col = np.arange(width) * CHART_COLS // width
    return values[row[:, None], col[None, :]]


def intensity_levels() -> NDArray[np.uint8]:
    """(18,) uint8: drive values of the intensity chart, rising from 0 to 255."""
    return np.arange(0, 256, _STEP).astype(np.uint8)


def intensity_chart(width: int, height: int, channel: int, step: int) -> NDArray[np.uint8]:
    """(height, width, 3) uint8 RGB frame, uniform: one channel at one level, the others off.

    Raises:
        ProjectionError: no such channel or step.
    """
    levels = intensity_levels()
    if not 0 <= channel < 3:
        raise ProjectionError(f"channel {channel} does not exist: 0 red, 1 green, 2 blue")
    if not 0 <= step < len(levels):
        raise ProjectionError(
            f"step {step} does not exist: the intensity chart has {len(levels)} frames, 0 to {len(levels) - 1}"
        )
    image = np.zeros((height, width, 3), dtype=np.uint8)
    image[..., channel] = levels[step]
    return image
