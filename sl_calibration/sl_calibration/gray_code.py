"""From captures of a Gray code sequence to projector coordinates (Inokuchi; section III.B).

A capture is a list of images in the order of projection: the bits of the columns, most significant first, each followed
by its inverse, then those of the rows, then (optionally) all white and all black.
"""

from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from pattern_gen.gray_code import Arrangement, bit_count, decode_words
from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]

_LIT = 0.08
_PAIR_TOLERANCE = 0.3
_SAMPLES = 4000
_GOOD_FIT = 0.6
_BROKEN_FIT = 3.0


class CaptureError(InvalidInputError):
    """The images of a capture are not what the Gray code sequence should give."""


@dataclass(frozen=True, eq=False)
class Capture:
    """Photographs of one Gray code sequence.

    Attributes:
        names: Names of the images, for messages.
        pairs: (2 * bits, 2, H, W) uint8: each bit and its inverse, columns first.
        white: (H, W) float64, lit by all of the projector.
        black: (H, W) float64, lit by ambient light alone.
        column_bits: Number of bits of the columns.
        projector: (width, height) [px].
        arrangement: Order of the code words.
    """

    names: tuple[str, ...]
    pairs: NDArray[np.uint8]
    white: Array
    black: Array
    column_bits: int
    projector: tuple[int, int]
    arrangement: Arrangement

    @property
    def contrast(self) -> Array:
        """(H, W) float64: light of the projector, white minus black."""
        return self.white - self.black

    @property
    def lit(self) -> NDArray[np.bool_]:
        """(H, W): where the projector gives enough light to decode."""
        contrast = self.contrast
        return contrast > max(_LIT * float(np.percentile(contrast, 99)), 3.0)

    @property
    def mean(self) -> NDArray[np.uint8]:
        """(H, W) uint8: mean of all patterns and inverses, stretched: the scene under even light, with little noise."""
        image = self.pairs.mean(axis=(0, 1), dtype=np.float32)
        low, high = np.percentile(image, (0.5, 99.5))
        return np.clip((image - low) / max(high - low, 1.0) * 240 + 8, 0, 255).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class GrayMap:
    """Projector coordinates of camera pixels.

    Attributes:
        column: (H, W) int64 projector column, -1 where not decoded.
        row: (H, W) int64 projector row, -1 where not decoded.
        contrast: (H, W) float64 light of the projector.
    """

    column: NDArray[np.int64]
    row: NDArray[np.int64]
    contrast: Array

    @property
    def decoded(self) -> NDArray[np.bool_]:
        """(H, W): where both coordinates are known."""
        return (self.column >= 0) & (self.row >= 0)


def image_count(projector: tuple[int, int]) -> int:
    """Number of images of a sequence for a projector (width, height), white and black not counted."""
    return 2 * (bit_count(projector[0]) + bit_count(projector[1]))


def make_capture(
    images: list[NDArray[np.uint8]],
    names: list[str],
    projector: tuple[int, int],
    arrangement: Arrangement = Arrangement.REFLECTED,
) -> Capture:
    """Sort the images of a sequence into a capture and check that they belong together.

    Args:
        images: (H, W) or (H, W, 3) uint8 each, in the order of projection; white and black may be missing.
        names: Their names, for messages.
        projector: (width, height) [px].
        arrangement: Order of the code words.

    Raises:
        CaptureError: wrong number or sizes of images, white and black swapped, no light, or an image out of place.
    """
    expected = image_count(projector)
    if len(images) not in (expected, expected + 2):
        raise CaptureError(
            f"{len(images)} images for a {projector[0]}x{projector[1]} projector, expected {expected + 2}:"
            f" {bit_count(projector[0])} column bits and {bit_count(projector[1])} row bits, each with its inverse,"
            " then white and black"
        )
    grey = [image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) for image in images]
    for name, image in zip(names, grey, strict=True):
        if image.shape != grey[0].shape:
            raise CaptureError(
                f"{name} is {image.shape[1]}x{image.shape[0]}, {names[0]} is {grey[0].shape[1]}x{grey[0].shape[0]}:"
                " all images of a capture come from one camera at one resolution"
            )
    pairs = np.stack(grey[:expected]).reshape(-1, 2, *grey[0].shape)
    if len(grey) == expected + 2:
        white, black = grey[-2].astype(np.float64), grey[-1].astype(np.float64)
        if white.mean() < black.mean():
            raise CaptureError(
                f"{names[-2]} should be all white and {names[-1]} all black, but the first is darker"
                f" ({white.mean():.1f} against {black.mean():.1f}): swapped images?"
            )
    else:
        white = pairs.max(axis=1).max(axis=0).astype(np.float64)
        black = pairs.min(axis=1).min(axis=0).astype(np.float64)
    capture = Capture(tuple(names), pairs, white, black, bit_count(projector[0]), projector, arrangement)
    if np.percentile(capture.contrast, 95) < 5:
        raise CaptureError(
            f"white and black differ by {np.percentile(capture.contrast, 95):.1f} grey levels only: is the projector's"
            " light in the image? Raise the exposure"
        )
    _check_pairs(capture)
    _check_last_bits(capture)
    return capture


def decode(capture: Capture) -> GrayMap:
    """Decode each lit pixel: a bit is set where the image is brighter than its inverse."""
    bits = capture.pairs[:, 0] > capture.pairs[:, 1]
    column = _coordinate(bits[: capture.column_bits], capture.projector[0], capture.arrangement)
    row = _coordinate(bits[capture.column_bits :], capture.projector[1], capture.arrangement)
    lit = capture.lit
    return GrayMap(np.where(lit, column, -1), np.where(lit, row, -1), capture.contrast)


def check_order(capture: Capture, region: NDArray[np.float64]) -> None:
    """Check on a smooth part of the scene that the decoded map is smooth, else find which images are in each other's
    place.

    Args:
        capture: The capture.
        region: (K, 2) pixels whose convex hull is a smooth surface, such as the corners of a board.

    Raises:
        CaptureError: naming the swapped images, or saying that the order is not that of a Gray code sequence.
    """
    mask = np.zeros(capture.white.shape, dtype=np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(np.round(region).astype(np.int32)), 1)
    y, x = np.nonzero(mask.astype(bool) & capture.lit)
    if len(x) < 200:
        raise CaptureError(
            f"only {len(x)} pixels of the board are lit by the projector: move it into the light or raise the exposure"
        )
    chosen = np.random.default_rng(0).permutation(len(x))[:_SAMPLES]
    x, y = x[chosen], y[chosen]
    bits = (capture.pairs[:, 0] > capture.pairs[:, 1])[:, y, x]
    place = np.stack([x - x.mean(), y - y.mean()], axis=-1) / max(float(np.ptp(x)), float(np.ptp(y)))
    columns = capture.column_bits
    slopes = []
    for name, own, length, offset in (
        ("column", bits[:columns], capture.projector[0], 0),
        ("row", bits[columns:], capture.projector[1], columns),
    ):
        fit, slope = _smoothness(_coordinate(own, length, capture.arrangement), place)
        slopes.append(slope)
        if fit <= _GOOD_FIT:
            continue
        swaps = _find_swaps(own, length, capture.arrangement, place, fit)
        if swaps:
            named = [" and ".join(capture.names[2 * offset + frame] for frame in pair) for pair in swaps]
            raise CaptureError(
                f"{' (or '.join(named[:3])}{')' * (len(named[:3]) - 1)} are swapped: the decoded {name}s are smooth"
                f" with"
                " them exchanged"
            )
        if fit > _BROKEN_FIT:
            raise CaptureError(
                f"the decoded {name}s jump across the board ({fit:.1f} px off a smooth map in the median): images"
                f" in the"
                f" wrong order, a wrong --projector size, or another arrangement than {capture.arrangement.value}"
            )
    if slopes[0][0] * slopes[1][1] - slopes[0][1] * slopes[1][0] < 0:
        first = (capture.names[0], capture.names[1])
        second = (capture.names[2 * columns], capture.names[2 * columns + 1])
        raise CaptureError(
            f"the decoded map is mirrored: {first[0]} and {first[1]} or {second[0]} and {second[1]} are swapped, or the"
            " image comes from a mirror or a rear projection"
        )


def _coordinate(bits: NDArray[np.bool_], length: int, arrangement: Arrangement) -> NDArray[np.int64]:
    words = np.zeros(bits.shape[1:], dtype=np.int64)
    for plane in bits:
        words = words << 1 | plane
    return decode_words(words, length, arrangement)


def _check_pairs(capture: Capture) -> None:
    """Image plus inverse must equal white plus black, whatever the camera's response at the two levels."""
    lit = np.argwhere(capture.lit)
    chosen = lit[np.random.default_rng(0).permutation(len(lit))[:_SAMPLES]]
    y, x = chosen.T
    sums = capture.pairs[:, :, y, x].astype(np.float64).sum(axis=1)
    contrast = np.abs(capture.pairs[:, 0, y, x].astype(np.float64) - capture.pairs[:, 1, y, x])
    usual = np.median(sums, axis=0)
    full = np.percentile(contrast, 90, axis=0)
    off = np.median(np.abs(sums - usual) / np.maximum(full, 1.0), axis=1)
    bad = np.flatnonzero(off > _PAIR_TOLERANCE)
    if len(bad):
        names = [f"{capture.names[2 * k]} and {capture.names[2 * k + 1]}" for k in bad]
        raise CaptureError(
            f"{'; '.join(names[:3])} {'are' if len(bad) == 1 else 'each are'} not a pattern and its inverse (their"
            f" sum is off by"
            f" {100 * off[bad[0]]:.0f} % of the contrast): swapped or stale images?"
        )


def _check_last_bits(capture: Capture) -> None:
    """The least significant bit of either axis alternates everywhere; a pair that does not is another kind of image."""
    lit = capture.lit
    for last in (capture.column_bits - 1, len(capture.pairs) - 1):
        share = float((capture.pairs[last, 0] > capture.pairs[last, 1])[lit].mean())
        if not 0.03 < share < 0.97:
            raise CaptureError(
                f"{capture.names[2 * last]} and {capture.names[2 * last + 1]} should be the finest bit and its"
                f" inverse, but one"
                f" is brighter in {100 * max(share, 1 - share):.0f} % of the image: is {capture.projector[0]}x"
                f"{capture.projector[1]} the projector's size, and are the images in order?"
            )


def _smoothness(values: NDArray[np.int64], place: Array) -> tuple[float, Array]:
    """Median distance [px] of decoded values (K,) from a smooth function of the place, and its slope (2,) at the
    middle."""
    known = values >= 0
    if known.sum() < 0.5 * len(values):
        return float("inf"), np.zeros(2)
    x, y = place[known].T
    basis = np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=-1)
    target = values[known].astype(np.float64)
    weight = np.ones(len(target))
    for _ in range(12):
        coefficients, *_ = np.linalg.lstsq(basis * weight[:, None], target * weight, rcond=None)
        error = np.abs(target - basis @ coefficients)
        weight = 1 / np.sqrt(np.maximum(error, 0.3))
    # basis: (0,0) (0,1) (0,2) (0,3) (1,0) ...
    return float(np.median(error)), np.array([coefficients[4], coefficients[1]])


def _find_swaps(
    bits: NDArray[np.bool_], length: int, arrangement: Arrangement, place: Array, fit: float
) -> list[tuple[int, int]]:
    """Try every exchange of two frames (of 2 * bits); return those that make the map smooth, the likeliest first.

    A bit with its inverse is likelier than two bits. On a part of the panel several exchanges may look alike.
    """
    found: list[tuple[float, int, tuple[int, int]]] = []
    for k in range(len(bits)):
        trial = bits.copy()
        trial[k] = ~trial[k]
        score, _ = _smoothness(_coordinate(trial, length, arrangement), place)
        found.append((score, 0, (2 * k, 2 * k + 1)))
    for k, m in combinations(range(len(bits)), 2):
        trial = bits.copy()
        trial[[k, m]] = trial[[m, k]]
        score, _ = _smoothness(_coordinate(trial, length, arrangement), place)
        found.append((score, 1, (2 * k, 2 * m)))
    best = min(score for score, _, _ in found)
    if best > fit / 2:
        return []
    alike = [entry for entry in found if entry[0] <= 1.2 * best + 0.05]
    return [pair for _, _, pair in sorted(alike, key=lambda entry: (entry[1], entry[0]))]
