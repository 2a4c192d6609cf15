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
from sl_decoder.compiled import compiled
from sl_decoder.segmentation import Segments

SUPPORT = 3.0  # the weight is zero at this many times the size of the core
STEP = 2.4  # times the weighted centroid's offset from the weight's middle: it moves by some 0.4 of the centre's
LOPSIDED = 0.7  # px between weighted centre and middle of the core, which agree in a disc that is whole and evenly lit
LANES = 16  # pixels of a blob are summed in groups of this many
SAMPLES = 16  # of the background around a blob
KEY, BLUE, GREEN, RED, BEFORE = range(0, 5 * SAMPLES, SAMPLES)  # where the samples' values begin
OUTSIDE = 0  # a place at the border, where the rest is always zero


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
def channels(colour):
    """B, G and R (float32) of a packed pixel (uint32) of the top-hat."""
    low = np.uint32(255)
    blue, green, red = colour & low, (colour >> np.uint32(8)) & low, (colour >> np.uint32(16)) & low
    return np.float32(np.int32(blue)), np.float32(np.int32(green)), np.float32(np.int32(red))


@compiled
def _ring_background(colours, rest, h, w, cx, cy, rx, ry, circle, place, word, left, ring, back):
    """Background of a blob: mean signal where no blob lies on the ellipse (rx, ry) around (cx, cy).

    The lower three quarters count: skirts of neighbours brighten the rest. Writes back (3,); returns the mean variance
    of a channel and how many samples count, fewer than three of them mean nothing. colours, rest (H W,): flat. Work
    space: place int32, word uint32, left uint8, (S,) each; ring (5 S,) float32, one array, so that the compiler sees
    that its rows do not overlap.
    """
    m = np.int32(0)
    for k in range(min(len(circle), SAMPLES)):
        x = np.int32(cx + rx * circle[k, 0] + np.float32(0.5))
        y = np.int32(cy + ry * circle[k, 1] + np.float32(0.5))
        inside = (x >= 1) & (y >= 1) & (x < w - 1) & (y < h - 1)
        place[k] = y * w + x if inside else OUTSIDE
    for k in range(SAMPLES):
        word[k] = colours[place[k]]
        left[k] = rest[place[k]]
    for k in range(min(len(circle), SAMPLES)):
        b, g, r = channels(word[k])
        value = max(max(b, g), r)
        free = (left[k] > 0) | ((value == 0) & (place[k] != OUTSIDE))
        # distinct keys: equal values keep their order
        ring[KEY + k] = value + np.float32(k) * np.float32(0.01) if free else np.float32(1e9)
        ring[BLUE + k], ring[GREEN + k], ring[RED + k] = b, g, r
        ring[BEFORE + k] = np.float32(0)
        m += np.int32(free)
    for j in range(SAMPLES):
        other = ring[KEY + j]
        for k in range(min(len(circle), SAMPLES)):
            ring[BEFORE + k] += np.float32(other < ring[KEY + k])
    kept = np.float32(m - m // 4)
    b0 = b1 = b2 = q = np.float32(0)
    for k in range(min(len(circle), SAMPLES)):
        use = np.float32(ring[BEFORE + k] < kept)
        p0, p1, p2 = ring[BLUE + k], ring[GREEN + k], ring[RED + k]
        b0 += use * p0
        b1 += use * p1
        b2 += use * p2
        q += use * (p0 * p0 + p1 * p1 + p2 * p2)
    r = np.float32(1) / max(kept, np.float32(1))
    b0, b1, b2 = b0 * r, b1 * r, b2 * r
    back[0], back[1], back[2] = b0, b1, b2
    return (q * r - b0 * b0 - b1 * b1 - b2 * b2) * np.float32(1 / 3), kept


@compiled
def _measure(
    colours,
    rest,
    pixels,
    start,
    peak,
    floor,
    circle,
    centre,
    colour,
    covariance,
    area,
    noise,
    saturated,
    cut,
    profile,
    shapes,
):
    h, w = rest.shape
    flat = colours.ravel()
    largest = 0
    for j in range(len(peak)):
        largest = max(largest, start[j + 1] - start[j])
    # rows: x, y, height, B, G, R, saturated, mixture; one array, so that the compiler sees that they do not overlap
    pixel = np.zeros((8, (largest + LANES - 1) // LANES * LANES), np.float32)
    ring = np.empty(5 * SAMPLES, np.float32)
    place = np.empty(max(pixel.shape[1], SAMPLES), np.int32)
    word = np.empty(SAMPLES, np.uint32)
    left = np.empty(SAMPLES, np.uint8)
    back = np.empty(3, np.float32)
    one, zero = np.float32(1), np.float32(0)
    for j in range(len(peak)):
        s = start[j]
        count = start[j + 1] - s
        whole = (count + LANES - 1) // LANES * LANES
        base = floor[j]
        half_height = np.float32(0.5) * (peak[j] - base)
        x_first, y_first = pixels[s] & 0xFFFF, pixels[s] >> 16
        for k in range(whole):
            at = pixels[s + k] if k < count else pixels[s]
            x, y = np.int32(at & 0xFFFF), np.int32(at >> 16)
            pixel[0, k] = np.float32(np.int32(x - x_first))
            pixel[1, k] = np.float32(np.int32(y - y_first))
            place[k] = y * w + x
        for k in range(whole):  # nothing else here, so that many cache misses are under way at once
            pixel[2, k] = np.uint32(flat[place[k]]).view(np.float32)
        west, east = np.float32(1 - x_first), np.float32(w - 2 - x_first)
        north, south = np.float32(1 - y_first), np.float32(h - 2 - y_first)
        outside = zero
        for k in range(whole):
            packed = np.float32(pixel[2, k]).view(np.uint32)
            blue, green, red = channels(packed)
            pixel[2, k] = max(max(blue, green), red) - base if k < count else -one  # below half of any peak
            pixel[3, k], pixel[4, k], pixel[5, k] = blue, green, red
            pixel[6, k] = np.float32(np.int32(packed >> np.uint32(24)))
            x, y = pixel[0, k], pixel[1, k]
            rim = (x <= west) | (y <= north) | (x >= east) | (y >= south)
            outside += np.float32(rim & (pixel[2, k] >= half_height))
        n = sx = sy = sw = mx = my = xx = xy = yy = c0 = c1 = c2 = sat = zero
        for k in range(whole):
            v = pixel[2, k]
            use = one if v >= half_height else zero
            dx = pixel[0, k]
            dy = pixel[1, k]
            n += use
            sw += use * v
            sx += use * v * dx
            sy += use * v * dy
            mx += use * dx
            my += use * dy
            xx += use * dx * dx
            xy += use * dx * dy
            yy += use * dy * dy
            c0 += use * pixel[3, k]
            c1 += use * pixel[4, k]
            c2 += use * pixel[5, k]
            sat += use * pixel[6, k]
        r = one / n
        mx *= r
        my *= r
        # a pixel is a square: its own variance adds
        xx = xx * r - mx * mx + np.float32(1 / 12)
        xy = xy * r - mx * my
        yy = yy * r - my * my + np.float32(1 / 12)
        fx, fy = sx / sw, sy / sw
        x0, y0 = np.float32(x_first), np.float32(y_first)
        cx, cy = x0 + fx, y0 + fy
        covariance[j, 0] = xx
        covariance[j, 1] = xy
        covariance[j, 2] = yy
        area[j] = int(n)
        saturated[j] = sat * r
        cut[j] = outside > zero
        profile[j] = np.float32(np.nan)
        rx = np.float32(3.2) * np.sqrt(xx) + np.float32(1.5)
        ry = np.float32(3.2) * np.sqrt(yy) + np.float32(1.5)
        variance, m = _ring_background(flat, rest.ravel(), h, w, cx, cy, rx, ry, circle, place, word, left, ring, back)
        if m >= 3:
            # neighbouring pixels share the filter: about three of them count as one
            noise[j] = np.sqrt(max(variance, np.float32(0.3)) * (one / m + one / max(one, n / np.float32(3))))
        else:
            back[:] = base
            noise[j] = max(base, one)
        c0 = c0 * r - back[0]
        c1 = c1 * r - back[1]
        c2 = c2 * r - back[2]
        colour[j, 0] = c0
        colour[j, 1] = c1
        colour[j, 2] = c2
        # the dot's own mixture of channels has the least noise
        w0 = max(c0, zero)
        w1 = max(c1, zero)
        w2 = max(c2, zero)
        total = w0 + w1 + w2
        if total <= 0:
            centre[j, 0] = cx
            centre[j, 1] = cy
            continue
        w0 /= total
        w1 /= total
        w2 /= total
        offset = w0 * back[0] + w1 * back[1] + w2 * back[2]
        for k in range(whole):
            pixel[7, k] = w0 * pixel[3, k] + w1 * pixel[4, k] + w2 * pixel[5, k] - offset if k < count else zero
        det = max(xx * yy - xy * xy, np.float32(1e-3)) * np.float32(SUPPORT * SUPPORT)
        ixx = yy / det
        ixy = np.float32(-2) * xy / det
        iyy = xx / det
        ox, oy = fx, fy
        for _ in range(4):
            sx = sy = sw = zero
            for k in range(whole):
                dx = pixel[0, k] - ox
                dy = pixel[1, k] - oy
                g = max(one - (ixx * dx * dx + ixy * dx * dy + iyy * dy * dy), zero)
                g = g * g * pixel[7, k]
                sw += g
                sx += g * dx
                sy += g * dy
            if sw <= 0:
                break
            sx = np.float32(STEP) * sx / sw
            sy = np.float32(STEP) * sy / sw
            ox += sx
            oy += sy
            if sx * sx + sy * sy < np.float32(2e-5):
                break
        if (ox - fx) ** 2 + (oy - fy) ** 2 > np.float32(0.5) * (xx + yy) + np.float32(0.25):
            ox, oy = fx, fy
        centre[j, 0] = x0 + ox
        centre[j, 1] = y0 + oy
        cut[j] |= (ox - mx) ** 2 + (oy - my) ** 2 > np.float32(LOPSIDED * LOPSIDED)
        if not shapes:
            continue
        sw = m2 = m4 = zero
        for k in range(whole):
            dx = pixel[0, k] - ox
            dy = pixel[1, k] - oy
            v = max(pixel[7, k], zero)
            r2 = ixx * dx * dx + ixy * dx * dy + iyy * dy * dy
            sw += v
            m2 += v * r2
            m4 += v * r2 * r2
        if m2 > 0:
            profile[j] = logarithm(m4 * sw / (m2 * m2))


_ANGLE = np.arange(SAMPLES) * (2 * np.pi / SAMPLES)
_CIRCLE = np.stack([np.cos(_ANGLE), np.sin(_ANGLE)], 1).astype(np.float32)


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
    _measure(
        segments.colour,
        segments.rest,
        segments.pixels,
        segments.start,
        segments.peak,
        segments.floor,
        _CIRCLE,
        dots.centre,
        dots.colour,
        dots.covariance,
        dots.area,
        dots.noise,
        dots.saturated,
        dots.cut,
        dots.profile,
        shapes,
    )
    return dots
