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


def smoothed(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Planes (3, H, W) uint8 of an image (H, W, 3) under the 3x3 binomial filter.

    It removes the frequency of a Bayer mosaic.
    """
    planes = np.empty((3, *bgr.shape[:2]), np.uint8)
    cv2.split(cv2.GaussianBlur(bgr, (3, 3), 0), list(planes))
    return planes


def background(smooth: NDArray[np.uint8], kernel: int) -> NDArray[np.uint8]:
    """Background (3, ceil(H / 2), ceil(W / 2)) uint8 of smoothed planes: their opening, at half resolution.

    kernel: side of the opening [px]; what is narrower vanishes.
    """
    _, h, w = smooth.shape
    half = np.empty((3, (h + 1) // 2, (w + 1) // 2), np.uint8)
    side = max(3, (kernel // 2) | 1)
    element = np.ones((side, side), np.uint8)
    for c in range(3):
        small = cv2.resize(smooth[c], half.shape[:0:-1], interpolation=cv2.INTER_AREA)
        cv2.morphologyEx(small, cv2.MORPH_OPEN, element, dst=half[c])
    return half


@compiled
def top_hat(smooth, half, hat):
    """Largest channel (H, W) uint8 of what stands above the background."""
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
            to = hat[y]
            for x in range(w):
                b = max(blue[x], wide[0, x]) - wide[0, x]
                g = max(green[x], wide[1, x]) - wide[1, x]
                r = max(red[x], wide[2, x]) - wide[2, x]
                to[x] = np.uint8(max(max(b, g), r))


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
