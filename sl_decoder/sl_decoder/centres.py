"""Sub-pixel centres, colours and shapes of blobs.

A blob's own pixels alone are used, above a background sampled around it where no blob lies. The centre is the centroid
under an elliptic weight of the blob's own shape that falls smoothly to zero, iterated to its fixed point; a hard
threshold would pull it towards the pixel grid.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sl_decoder.approximation import logarithm
from sl_decoder.backgrounds import CIRCLE, sample_backgrounds
from sl_decoder.compiled import compiled
from sl_decoder.planes import channels
from sl_decoder.segmentation import LANES, Segments

SUPPORT = 3.0  # the weight is zero at this many times the size of the core
STEP = 2.4  # times the weighted centroid's offset from the weight's middle: it moves by some 0.4 of the centre's
ROUNDS = 4  # steps at most
SETTLED = 4.5e-3  # a step [px] after which the centre has been reached
LOPSIDED = 0.7  # px between weighted centre and middle of the core, which agree in a disc that is whole and evenly lit


@dataclass(frozen=True)
class Dots:
    """Measured dots, N entries each.

    centre (N, 2) float32 px; colour (N, 3) float32 B, G, R above the background, mean over the core, counts;
    covariance (N, 3) float32 xx, xy, yy of the core, px^2; area (N,) int32 pixels of the core (above half of the peak);
    noise (N,) float32 uncertainty of a colour channel, counts; saturated (N,) float32 share of saturated core pixels;
    cut (N,) bool: touches the border of the image, or is lit so unevenly that its centre cannot be trusted;
    profile (N,) float32: logarithm of the affine-invariant radial kurtosis, which tells shapes apart (ring < disc <
    square < cross, triangle); nan where it could not be measured.
    """

    centre: NDArray[np.float32]
    colour: NDArray[np.float32]
    covariance: NDArray[np.float32]
    area: NDArray[np.int32]
    noise: NDArray[np.float32]
    saturated: NDArray[np.float32]
    cut: NDArray[np.bool_]
    profile: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.noise)


@compiled
def _gather(colours, pixels, packed):
    """Colours (H, W) of the pixels (P,): packed (P + LANES,) uint32.

    Nothing else is done here, so that many cache misses are under way at once.
    """
    flat, w = colours.ravel(), np.int32(colours.shape[1])
    for k in range(len(pixels)):
        packed[k] = flat[(pixels[k] >> 16) * w + (pixels[k] & 0xFFFF)]
    packed[len(pixels) :] = 0


@compiled
def _find_cores(pixels, packed, start, peak, floor, h, w, centre, middle, colour, covariance, area, saturated, cut):
    """The cores of the blobs, which are their pixels above half of the peak.

    Writes their centroids, weighted by height in `centre` and plain in `middle` (N, 2), mean colour (N, 3), covariance
    (N, 3), area, share of saturated pixels, and whether one of them lies at the border of the image.
    """
    one, zero = np.float32(1), np.float32(0)
    right, bottom = np.int32(w - 2), np.int32(h - 2)
    for j in range(len(peak)):
        count = np.int32(start[j + 1] - start[j])
        whole = (count + LANES - 1) // LANES * LANES
        place, word = pixels[start[j] : start[j] + whole], packed[start[j] : start[j] + whole]
        base = floor[j]
        half_height = np.float32(0.5) * (peak[j] - base)
        x_first, y_first = np.int32(place[0] & 0xFFFF), np.int32(place[0] >> 16)
        n = sx = sy = sw = mx = my = xx = xy = yy = c0 = c1 = c2 = sat = outside = zero
        for k in range(whole):
            x, y = np.int32(place[k] & 0xFFFF), np.int32(place[k] >> 16)
            blue, green, red = channels(word[k])
            v = max(max(blue, green), red) - base
            core = (v >= half_height) & (np.int32(k) < count)
            use = one if core else zero
            height = v if core else zero
            dx, dy = np.float32(np.int32(x - x_first)), np.float32(np.int32(y - y_first))
            n += use
            sw += height
            sx += height * dx
            sy += height * dy
            mx += use * dx
            my += use * dy
            xx += use * dx * dx
            xy += use * dx * dy
            yy += use * dy * dy
            c0 += use * blue
            c1 += use * green
            c2 += use * red
            sat += use * np.float32(np.int32(word[k] >> np.uint32(24)))
            outside += use if (x <= 1) | (y <= 1) | (x >= right) | (y >= bottom) else zero
        r = one / n
        mx *= r
        my *= r
        # a pixel is a square: its own variance adds
        covariance[j, 0] = xx * r - mx * mx + np.float32(1 / 12)
        covariance[j, 1] = xy * r - mx * my
        covariance[j, 2] = yy * r - my * my + np.float32(1 / 12)
        centre[j, 0], centre[j, 1] = np.float32(x_first) + sx / sw, np.float32(y_first) + sy / sw
        middle[j, 0], middle[j, 1] = np.float32(x_first) + mx, np.float32(y_first) + my
        colour[j, 0], colour[j, 1], colour[j, 2] = c0 * r, c1 * r, c2 * r
        area[j] = int(n)
        saturated[j] = sat * r
        cut[j] = outside > zero


@compiled
def _subtract_backgrounds(floor, area, back, variance, number, colour, noise):
    """Colours (N, 3) above the backgrounds (N, 3), and their noise (N,); `floor` in place of missing backgrounds."""
    one = np.float32(1)
    for j in range(len(floor)):
        m, n = number[j], np.float32(area[j])
        # neighbouring pixels share the filter: about three of them count as one
        noise[j] = np.sqrt(max(variance[j], np.float32(0.3)) * (one / m + one / max(one, n / np.float32(3))))
        if m < 3:
            back[j] = floor[j]
            noise[j] = max(floor[j], one)
        for c in range(3):
            colour[j, c] -= back[j, c]


@compiled
def _refine(pixels, packed, start, back, colour, covariance, middle, shapes, centre, cut, profile):
    """Move the centres (N, 2) to the centroids under the weights around them, in the dots' own mixtures of channels.

    Marks in `cut` what is lopsided, and measures the profiles where `shapes` is true.
    """
    largest = 0
    for j in range(len(centre)):
        largest = max(largest, start[j + 1] - start[j])
    # rows: x, y, mixture; one array, so that the compiler sees that they do not overlap
    pixel = np.empty((3, (largest + LANES - 1) // LANES * LANES), np.float32)
    one, zero = np.float32(1), np.float32(0)
    for j in range(len(centre)):
        # the dot's own mixture of channels has the least noise
        w0, w1, w2 = max(colour[j, 0], zero), max(colour[j, 1], zero), max(colour[j, 2], zero)
        total = w0 + w1 + w2
        profile[j] = np.float32(np.nan)
        if total <= 0:
            continue
        w0, w1, w2 = w0 / total, w1 / total, w2 / total
        offset = w0 * back[j, 0] + w1 * back[j, 1] + w2 * back[j, 2]
        count = start[j + 1] - start[j]
        whole = (count + LANES - 1) // LANES * LANES
        place, word = pixels[start[j] : start[j] + whole], packed[start[j] : start[j] + whole]
        x_first, y_first = np.int32(place[0] & 0xFFFF), np.int32(place[0] >> 16)
        for k in range(whole):
            blue, green, red = channels(word[k])
            pixel[0, k] = np.float32(np.int32((place[k] & 0xFFFF) - x_first))
            pixel[1, k] = np.float32(np.int32((place[k] >> 16) - y_first))
            pixel[2, k] = w0 * blue + w1 * green + w2 * red - offset if k < count else zero
        xx, xy, yy = covariance[j, 0], covariance[j, 1], covariance[j, 2]
        det = max(xx * yy - xy * xy, np.float32(1e-3)) * np.float32(SUPPORT * SUPPORT)
        ixx = yy / det
        ixy = np.float32(-2) * xy / det
        iyy = xx / det
        x0, y0 = np.float32(x_first), np.float32(y_first)
        fx, fy = centre[j, 0] - x0, centre[j, 1] - y0
        ox, oy = fx, fy
        for _ in range(ROUNDS):
            sx = sy = sw = zero
            for k in range(whole):
                dx = pixel[0, k] - ox
                dy = pixel[1, k] - oy
                g = max(one - (ixx * dx * dx + ixy * dx * dy + iyy * dy * dy), zero)
                g = g * g * pixel[2, k]
                sw += g
                sx += g * dx
                sy += g * dy
            if sw <= 0:
                break
            sx = np.float32(STEP) * sx / sw
            sy = np.float32(STEP) * sy / sw
            ox += sx
            oy += sy
            if sx * sx + sy * sy < np.float32(SETTLED * SETTLED):
                break
        if (ox - fx) ** 2 + (oy - fy) ** 2 > np.float32(0.5) * (xx + yy) + np.float32(0.25):
            ox, oy = fx, fy
        centre[j, 0] = x0 + ox
        centre[j, 1] = y0 + oy
        lean = (centre[j, 0] - middle[j, 0]) ** 2 + (centre[j, 1] - middle[j, 1]) ** 2
        cut[j] |= lean > np.float32(LOPSIDED * LOPSIDED)
        if not shapes:
            continue
        sw = m2 = m4 = zero
        for k in range(whole):
            dx = pixel[0, k] - ox
            dy = pixel[1, k] - oy
            v = max(pixel[2, k], zero)
            r2 = ixx * dx * dx + ixy * dx * dy + iyy * dy * dy
            sw += v
            m2 += v * r2
            m4 += v * r2 * r2
        if m2 > 0:
            profile[j] = logarithm(m4 * sw / (m2 * m2))


def measure(segments: Segments, *, shapes: bool = True) -> Dots:
    """Measure all blobs of a segmented image; shapes: their profiles too, where letters differ in shape."""
    n = len(segments)
    dots = Dots(
        centre=np.empty((n, 2), np.float32),
        colour=np.empty((n, 3), np.float32),
        covariance=np.empty((n, 3), np.float32),
        area=np.empty(n, np.int32),
        noise=np.empty(n, np.float32),
        saturated=np.empty(n, np.float32),
        cut=np.empty(n, np.bool_),
        profile=np.zeros(n, np.float32),
    )
    middle, back = np.empty((n, 2), np.float32), np.empty((n, 3), np.float32)
    variance, number = np.empty(n, np.float32), np.empty(n, np.float32)
    h, w = segments.rest.shape
    packed = np.empty(segments.start[-1] + LANES, np.uint32)
    _gather(segments.colour, segments.pixels[: segments.start[-1]], packed)
    _find_cores(
        segments.pixels,
        packed,
        segments.start,
        segments.peak,
        segments.floor,
        h,
        w,
        dots.centre,
        middle,
        dots.colour,
        dots.covariance,
        dots.area,
        dots.saturated,
        dots.cut,
    )
    sample_backgrounds(segments.colour, segments.rest, dots.centre, dots.covariance, CIRCLE, back, variance, number)
    _subtract_backgrounds(segments.floor, dots.area, back, variance, number, dots.colour, dots.noise)
    _refine(
        segments.pixels,
        packed,
        segments.start,
        back,
        dots.colour,
        dots.covariance,
        middle,
        shapes,
        dots.centre,
        dots.cut,
        dots.profile,
    )
    return dots
