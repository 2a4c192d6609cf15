"""The light a projector sends out for the image it is given."""

from dataclasses import dataclass

import cv2
import numpy as np

SRGB = "srgb"


@dataclass(frozen=True, kw_only=True)
class ProjectorOptions:
    """What happens between a drive value and light.

    Attributes:
        gamma: exponent of the drive-to-light curve, one per channel (R, G, B), or "srgb".
        crosstalk: (3, 3) light of channel i (R, G, B) when channel j is driven: leaking colour filters.
        black_level: light of a black pixel, as a share of white.
        blur: standard deviation of the lens blur on the panel [projector px].
        vignetting: loss of light at the panel's corner farthest from the optical axis, as a share.
        brightness: irradiance of white on a facing surface at 1 m, relative to the camera's unit.
    """

    gamma: tuple[float, float, float] | str = (2.1, 2.2, 2.3)
    crosstalk: tuple[tuple[float, float, float], ...] = ((1.0, 0.05, 0.01), (0.05, 1.0, 0.06), (0.01, 0.06, 1.0))
    black_level: float = 0.0015
    blur: float = 0.5
    vignetting: float = 0.15
    brightness: float = 1.0


LIGHT_SCALE = 2
"""Texels of the light image per projector pixel and axis: pixels are squares of light before the lens blurs them."""


def srgb_to_linear(value: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1 decoding of values in [0, 1]."""
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(value: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1 encoding of values in [0, 1]."""
    return np.where(value <= 0.0031308, value * 12.92, 1.055 * np.maximum(value, 0.0) ** (1 / 2.4) - 0.055)


def channel_light(rgb: np.ndarray, options: ProjectorOptions) -> np.ndarray:
    """Light (..., 3) RGB, relative to white's channel, for drive values (..., 3) uint8 RGB; no blur."""
    levels = np.arange(256) / 255.0
    if isinstance(options.gamma, str):
        curves = np.tile(srgb_to_linear(levels), (3, 1))
    else:
        curves = np.stack([levels**g for g in options.gamma])
    driven = np.stack([curves[k][rgb[..., k]] for k in range(3)], -1)
    mixing = np.asarray(options.crosstalk, float)
    mixing = mixing / mixing.sum(1, keepdims=True)
    light = options.black_level + (1.0 - options.black_level) * (driven @ mixing.T)
    return (options.brightness * light).astype(np.float32)


def light_image(bgr: np.ndarray, options: ProjectorOptions) -> np.ndarray:
    """Light (LIGHT_SCALE * H, LIGHT_SCALE * W, 3) float32 RGB sent out for a projector image (H, W, 3) uint8 BGR."""
    light = channel_light(bgr[..., ::-1], options)
    light = np.repeat(np.repeat(light, LIGHT_SCALE, axis=0), LIGHT_SCALE, axis=1)
    if options.blur > 0:
        light = cv2.GaussianBlur(light, (0, 0), options.blur * LIGHT_SCALE, borderType=cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(light)
