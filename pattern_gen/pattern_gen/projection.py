"""What the projector shows: frames by mode, and the spot size that suits the camera's view (section III.B)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from pattern_gen.charts import colour_chart, colour_chart_drives, intensity_chart, intensity_levels
from pattern_gen.errors import ProjectionError
from pattern_gen.gray_code import Arrangement, Axis, bit_count, code_frame
from pattern_gen.pattern import Pattern


class Mode(IntEnum):
    """What to show; the values of sl_msgs/srv/SetProjection."""

    PATTERN = 0
    GRAY_CODE = 1
    WHITE = 2
    BLACK = 3
    COLOUR_CHART = 4
    INTENSITY_CHART = 5


@dataclass(frozen=True, kw_only=True)
class FrameRequest:
    """One frame.

    Attributes:
        axis, bit, inverse: of a GRAY_CODE frame.
        channel: of an INTENSITY_CHART frame: 0 red, 1 green, 2 blue.
        step: of a chart.
    """

    mode: Mode
    axis: Axis = Axis.COLUMNS
    bit: int = 0
    inverse: bool = False
    channel: int = 0
    step: int = 0


def render_frame(
    pattern: Pattern, request: FrameRequest, arrangement: Arrangement = Arrangement.REFLECTED
) -> tuple[NDArray[np.uint8], int, str]:
    """The frame, the number of frames of its mode, and what it is in words.

    Returns:
        image: (H, W, 3) uint8 RGB.

    Raises:
        ProjectionError: there is no such frame.
    """
    width, height = pattern.projector_width, pattern.projector_height
    if request.mode is Mode.PATTERN:
        return pattern.render(), 1, f"pattern {pattern.pattern_id}, spots of {pattern.spot_diameter:.2f} px"
    if request.mode is Mode.GRAY_CODE:
        image = code_frame(width, height, request.axis, request.bit, inverse=request.inverse, arrangement=arrangement)
        bits = bit_count(width if request.axis is Axis.COLUMNS else height)
        kind = "inverse of bit" if request.inverse else "bit"
        return image, bits, f"Gray code, {request.axis.value}, {kind} {request.bit} of {bits} ({arrangement.value})"
    if request.mode is Mode.COLOUR_CHART:
        image, frames = colour_chart(width, height, request.step), len(colour_chart_drives())
        return image, frames, f"colour chart, frame {request.step} of {frames}"
    if request.mode is Mode.INTENSITY_CHART:
        image, frames = intensity_chart(width, height, request.channel, request.step), len(intensity_levels())
        return image, frames, f"intensity chart, channel {request.channel}, frame {request.step} of {frames}"
    value = 255 if request.mode is Mode.WHITE else 0
    return np.full((height, width, 3), value, dtype=np.uint8), 1, request.mode.name.lower()


@dataclass(frozen=True, kw_only=True)
class SpotLimits:
    """Limits of the spots' size.

    Attributes:
        smallest: diameter in projector [px].
        largest_fraction: diameter over the distance of the spots; the rest stays dark and separates them.
        tolerance: relative change below which the size is left as it is.
    """

    smallest: float = 2.0
    largest_fraction: float = 0.75
    tolerance: float = 0.03


def adapted_diameter(
    pattern: Pattern, spot_camera_px: float, camera_px_per_projector_px: float, limits: SpotLimits
) -> float:
    """Spot diameter in projector [px] that looks `spot_camera_px` wide to the camera, within the limits.

    Args:
        spot_camera_px: wanted diameter in the camera image [px].
        camera_px_per_projector_px: present magnification, as the decoder measures it from the spots' distances.

    Raises:
        ProjectionError: a value that is not a positive number.
    """
    for name, value in (("spot_camera_px", spot_camera_px), ("camera_px_per_projector_px", camera_px_per_projector_px)):
        if not (np.isfinite(value) and value > 0):
            raise ProjectionError(f"{name} is {value:g}, it must be a positive number")
    wanted = spot_camera_px / camera_px_per_projector_px
    largest = limits.largest_fraction * pattern.pitch
    return float(np.clip(wanted, min(limits.smallest, largest), largest))
