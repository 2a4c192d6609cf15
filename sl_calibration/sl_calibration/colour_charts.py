"""From photographs of the projected charts to camera values of drive values.

No correspondence between camera and projector is needed: over all frames of the colour chart every place sees every
drive value once, in an order that tells which patch it belongs to.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pattern_gen.charts import CHART_COLS, CHART_ROWS, colour_chart_drives, colour_chart_values, intensity_levels
from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]

_PLACES = 6000
_LEAST_CORRELATION = 0.85
_SURFACES = 4


@dataclass(frozen=True, eq=False)
class ChartSamples:
    """Camera values of drive values on the scene's typical surface.

    Attributes:
        drives: (K, 3) float64 drive values, R G B.
        camera: (K, 3) float64 camera values above black, R G B.
        albedos: (S, 3) surfaces of the scene: factors on the typical camera values, R G B.
        places: Number of pixels used.
    """

    drives: Array
    camera: Array
    albedos: Array
    places: int


def colour_chart_samples(frames: NDArray[np.uint8], intensity_frames: NDArray[np.uint8] | None = None) -> ChartSamples:
    """Read the charts.

    Args:
        frames: (28, H, W, 3) BGR photographs of all frames of the colour chart, in order.
        intensity_frames: (54, H, W, 3) BGR photographs of the intensity chart: 18 levels of red, green, blue; or None.

    Raises:
        InvalidInputError: a wrong number of frames, no light, a saturated camera, frames in the wrong order.
    """
    drives = colour_chart_drives().astype(np.float64)
    count = len(drives)
    if frames.ndim != 4 or len(frames) != count or frames.shape[-1] != 3:
        raise InvalidInputError(
            f"the colour chart has {count} frames, got {len(frames)}: take one colour photo of each"
        )
    pixels = _choose(frames)
    seen = frames[:, pixels[:, 0], pixels[:, 1], ::-1].astype(np.float64)  # (F, P, 3) R G B
    saturated = float((seen.max(axis=0) >= 252).any(-1).mean())
    if saturated > 0.9:
        raise InvalidInputError(
            f"the camera saturates on {100 * saturated:.0f} % of the lit places: shorten the exposure until white"
            f" is not"
        )
    patch = _patches(seen)
    found = patch >= 0
    if found.sum() < max(50, 0.3 * len(found)):
        raise InvalidInputError(
            f"only {100 * found.mean():.0f} % of the lit places show the chart's sequence: frames missing or in the"
            f" wrong"
            " order, automatic exposure, or a scene that moved"
        )
    seen, patch = seen[:, found], patch[found]
    order = (patch[None, :] - np.arange(count)[:, None]) % count  # drive index shown at each frame
    by_drive = np.empty_like(seen)
    np.put_along_axis(by_drive, order[..., None], seen, axis=0)
    white = int(np.argmax(drives.sum(1)))
    black = int(np.argmin(drives.sum(1)))
    dark = by_drive[black]
    bright = by_drive[white] - dark
    unsaturated = (by_drive[white] < 252).all(-1)
    keep = unsaturated & (bright > 5).all(-1)
    if keep.sum() < 20:
        raise InvalidInputError(f"only {keep.sum()} places see all three colours of the chart: raise the exposure")
    by_drive, dark, bright = by_drive[:, keep], dark[keep], bright[keep]
    typical = np.median(bright, axis=0)
    near = (np.abs(np.log(bright / typical)) < 0.7).all(-1)
    scaled = (by_drive - dark) * (typical / bright)
    samples = np.median(scaled[:, near], axis=1)
    all_drives = drives
    if intensity_frames is not None:
        kept = pixels[found][keep][near]
        extra_drives, extra = _intensities(intensity_frames, kept, dark[near], typical / bright[near])
        all_drives, samples = np.concatenate([drives, extra_drives]), np.concatenate([samples, extra])
    return ChartSamples(all_drives, samples, _surfaces(bright / typical), int(near.sum()))


def _choose(frames: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Pixels (P, 2: row, column) that the projector lights."""
    light = frames.max(axis=-1)
    contrast = light.max(axis=0).astype(np.float64) - light.min(axis=0)
    limit = max(0.2 * float(np.percentile(contrast, 98)), 12.0)
    lit = np.argwhere(contrast > limit)
    if len(lit) < 100:
        raise InvalidInputError(
            f"only {len(lit)} pixels change with the chart: is the projector's light in the image, and the exposure"
            f" long"
            " enough?"
        )
    return lit[np.random.default_rng(0).permutation(len(lit))[:_PLACES]]


def _patches(seen: Array) -> NDArray[np.int64]:
    """Patch (P,) that each place belongs to, from its brightness over the frames (F, P, 3); -1 where none fits."""
    count = len(seen)
    shown = np.stack([colour_chart_values(step).reshape(CHART_ROWS * CHART_COLS, 3) for step in range(count)])
    expected = ((shown / 255.0) ** 2.2).transpose(2, 0, 1)  # (3, F, patch)
    score = np.zeros((seen.shape[1], expected.shape[-1]))
    for channel in range(3):
        own = _standardised(np.sqrt(np.maximum(seen[..., channel], 0)))
        wanted = _standardised(expected[channel] ** 0.35)
        score += own.T @ wanted / count
    best = score.argmax(axis=1)
    return np.where(score.max(axis=1) / 3 > _LEAST_CORRELATION - 0.2, best, -1)


def _standardised(values: Array) -> Array:
    centred = values - values.mean(axis=0)
    return centred / np.maximum(centred.std(axis=0), 1e-9)


def _intensities(
    frames: NDArray[np.uint8], pixels: NDArray[np.int64], dark: Array, scale: Array
) -> tuple[Array, Array]:
    levels = intensity_levels().astype(np.float64)
    if frames.ndim != 4 or len(frames) != 3 * len(levels) or frames.shape[-1] != 3:
        raise InvalidInputError(
            f"the intensity chart has {3 * len(levels)} frames, {len(levels)} of each channel, got {len(frames)}"
        )
    seen = frames[:, pixels[:, 0], pixels[:, 1], ::-1].astype(np.float64)
    values = np.median((seen - dark) * scale, axis=1)
    drives = np.zeros((3 * len(levels), 3))
    for channel in range(3):
        drives[channel * len(levels) : (channel + 1) * len(levels), channel] = levels
    return drives, values


def _surfaces(relative: Array) -> Array:
    """A few typical surfaces (S, 3) of relative albedos (P, 3): means of groups of like colours."""
    logarithm = np.log(np.maximum(relative, 1e-3)).astype(np.float32)
    groups = min(_SURFACES, len(logarithm))
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-3)
    cv2.setRNGSeed(0)
    _, labels, centres = cv2.kmeans(logarithm, groups, None, criteria, 3, cv2.KMEANS_PP_CENTERS)
    share = np.bincount(labels.ravel(), minlength=groups) / len(labels)
    return np.exp(centres[share > 0.03].astype(np.float64))
