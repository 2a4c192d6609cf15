"""The image as planes: smoothed, without its background, and the places of its maxima.

Everything that touches every pixel is here, written as loops over rows without branches, which the compiler turns into
vector code. Colour channels are planes, (3, H, W): a row of one channel is then contiguous.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sl_decoder.compiled import compiled

SATURATED = 250  # a channel from here on has lost its proportion


def smoothed(bgr: NDArray[np.uint8], planes: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
    """Planes (3, H, W) uint8 of an image (H, W, 3) under the 3x3 binomial filter, mirrored at the border.

    It removes the frequency of a Bayer mosaic. planes: those of an earlier image, overwritten if they have the size:
    fresh memory costs as much time as the filter.
    """
    shape = (3, *bgr.shape[:2])
    if planes is None or planes.shape != shape:
        planes = np.empty(shape, np.uint8)
    binomial(np.ascontiguousarray(bgr), planes)
    return planes


@compiled
def binomial(bgr, smooth):
    """An image (H, W, 3) uint8 under the filter 1 2 1 over 4 along rows and columns, rounded once: smooth (3, H, W)."""
    h, w, _ = bgr.shape
    rows = bgr.reshape((h, 3 * w))
    column = np.empty(3 * w + 6, np.uint16)
    mixed = np.empty(3 * w, np.uint8)
    two, half = np.uint16(2), np.uint16(8)
    for y in range(h):
        above, here, below = rows[abs(y - 1)], rows[y], rows[min(y + 1, 2 * h - 3 - y)]
        for i in range(3 * w):
            column[i + 3] = np.uint16(above[i]) + two * np.uint16(here[i]) + np.uint16(below[i])
        for c in range(3):
            column[c], column[3 * w + 3 + c] = column[c + 6], column[3 * w - 3 + c]
        for i in range(3 * w):
            mixed[i] = (column[i] + two * column[i + 3] + column[i + 6] + half) >> np.uint16(4)
        blue, green, red = smooth[0, y], smooth[1, y], smooth[2, y]
        for x in range(w):
            blue[x], green[x], red[x] = mixed[3 * x], mixed[3 * x + 1], mixed[3 * x + 2]


@compiled
def halve(planes, small):
    """Mean of every 2x2 pixels of planes (3, H, W) uint8: small (3, ceil(H / 2), ceil(W / 2)) uint8."""
    _, h, w = planes.shape
    for c in range(3):
        for y in range(small.shape[1]):
            one, two, out = planes[c, 2 * y], planes[c, min(2 * y + 1, h - 1)], small[c, y]
            for x in range(w // 2):
                left = np.uint16(one[2 * x]) + np.uint16(two[2 * x])
                total = left + np.uint16(one[2 * x + 1]) + np.uint16(two[2 * x + 1]) + np.uint16(2)
                out[x] = np.uint8(total >> np.uint16(2))
            if w & 1:
                out[w // 2] = np.uint8((np.uint16(one[w - 1]) + np.uint16(two[w - 1]) + np.uint16(1)) >> np.uint16(1))


def background(smooth: NDArray[np.uint8], kernel: int) -> NDArray[np.uint8]:
    """Background (3, ceil(H / 2), ceil(W / 2)) uint8 of smoothed planes: their opening, at half resolution.

    kernel: side of the opening [px]; what is narrower vanishes.
    """
    _, h, w = smooth.shape
    half = np.empty((3, (h + 1) // 2, (w + 1) // 2), np.uint8)
    halve(smooth, half)
    side = max(3, (kernel // 2) | 1)
    element = np.ones((side, side), np.uint8)
    for plane in half:
        cv2.morphologyEx(plane, cv2.MORPH_OPEN, element, dst=plane)
    return half


@compiled
def _above(value, background):
    """How far a value stands above the background, uint8; numba would go on with 64 bits, an eighth of the lanes."""
    return np.uint8(max(value, background) - background)


@compiled
def top_hat(smooth, half, hat, colour):
    """What stands above the background: hat (H, W) uint8 its largest channel, colour (H, W) uint32 its channels.

    A colour is B + 256 G + 65536 R, plus 2^24 where the image is saturated: all that is to be known of a pixel in one
    word.
    """
    _, h, w = smooth.shape
    wide = np.empty((3, w + 2), np.uint8)
    for hy in range((h + 1) // 2):
        for c in range(3):
            row = half[c, hy]
            out = wide[c]
            for x in range(len(row)):
                out[2 * x] = row[x]
                out[2 * x + 1] = row[x]
        for y in range(2 * hy, min(h, 2 * hy + 2)):
            blue, green, red = smooth[0, y], smooth[1, y], smooth[2, y]
            to, word = hat[y], colour[y]
            for x in range(w):
                b, g, r = _above(blue[x], wide[0, x]), _above(green[x], wide[1, x]), _above(red[x], wide[2, x])
                to[x] = max(max(b, g), r)
            for x in range(w):
                b = np.uint32(_above(blue[x], wide[0, x]))
                g = np.uint32(_above(green[x], wide[1, x]))
                r = np.uint32(_above(red[x], wide[2, x]))
                full = np.uint32(max(max(blue[x], green[x]), red[x]) >= np.uint8(SATURATED))
                word[x] = b | (g << np.uint32(8)) | (r << np.uint32(16)) | (full << np.uint32(24))


@compiled
def channels(colour):
    """B, G and R (float32) of a packed pixel (uint32) of the top-hat."""
    low = np.uint32(255)
    blue, green, red = colour & low, (colour >> np.uint32(8)) & low, (colour >> np.uint32(16)) & low
    return np.float32(np.int32(blue)), np.float32(np.int32(green)), np.float32(np.int32(red))


@compiled
def mark_maxima(hat, limits, block, maximum):
    """Mark the local maxima of hat (H, W) above limits (rows and columns of blocks) uint8: maximum (H, W) uint8.

    Of a plateau, its last pixel. The border holds none.
    """
    h, w = hat.shape
    maximum[0] = 0
    maximum[h - 1] = 0
    limit = np.empty(w, np.uint8)
    for y in range(1, h - 1):
        if y == 1 or y % block == 0:
            for x in range(w):
                limit[x] = limits[y // block, x // block]
        up, here, down, out = hat[y - 1], hat[y], hat[y + 1], maximum[y]
        for x in range(1, w - 1):
            v = here[x]
            before = max(max(up[x - 1], up[x]), max(up[x + 1], here[x - 1]))
            after = max(max(down[x - 1], down[x]), max(down[x + 1], here[x + 1]))
            out[x] = np.uint8((v >= before) & (v > after) & (v > limit[x]))
        out[0] = 0
        out[w - 1] = 0
