"""Backgrounds of blobs, sampled on ellipses around them where no blob lies.

The loops run over a block of blobs innermost, without branches, which the compiler turns into vector code.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.compiled import compiled
from sl_decoder.planes import channels

SAMPLES = 16  # of the background around a blob
BLOCK = 64  # blobs whose backgrounds are sampled at once
OUTSIDE = 0  # a place at the border, where the rest is always zero
TAKEN = np.int16(32767)  # the rank of a sample that lies in a blob, or outside

_ANGLE = np.arange(SAMPLES) * (2 * np.pi / SAMPLES)
CIRCLE = np.stack([np.cos(_ANGLE), np.sin(_ANGLE)], 1).astype(np.float32)


@compiled
def sample_backgrounds(colours, rest, centre, covariance, circle, back, variance, number):
    """Backgrounds of the blobs: mean signal where no blob lies on an ellipse around each, sampled at `circle` (S, 2).

    The lower three quarters count: skirts of neighbours brighten the rest. Writes their mean back (N, 3), the mean
    variance of a channel (N,) and their number (N,), fewer than three of which mean nothing. The loops run over a block
    of blobs innermost, without branches.
    """
    h, w = rest.shape
    flat, left = colours.ravel(), rest.ravel()
    place = np.empty((SAMPLES, BLOCK), np.int32)
    word = np.empty((SAMPLES, BLOCK), np.uint32)
    empty = np.empty((SAMPLES, BLOCK), np.uint8)
    key = np.empty((SAMPLES, BLOCK), np.int16)
    at = np.zeros((4, BLOCK), np.float32)
    sums = np.empty((5, BLOCK), np.float32)
    for begin in range(0, len(centre), BLOCK):
        size = min(BLOCK, len(centre) - begin)
        for i in range(size):
            at[0, i], at[1, i] = centre[begin + i, 0], centre[begin + i, 1]
            at[2, i], at[3, i] = covariance[begin + i, 0], covariance[begin + i, 2]
        _place_samples(at, circle, h, w, place)
        for k in range(SAMPLES):  # nothing else here, so that many cache misses are under way at once
            for i in range(BLOCK):
                word[k, i] = flat[place[k, i]]
                empty[k, i] = left[place[k, i]]
        _rank(word, empty, place, key)
        _mean_of_lowest(word, key, sums)
        for i in range(size):
            back[begin + i, 0], back[begin + i, 1], back[begin + i, 2] = sums[0, i], sums[1, i], sums[2, i]
            variance[begin + i], number[begin + i] = sums[3, i], sums[4, i]


@compiled
def _place_samples(at, circle, h, w, place):
    """Places (S, BLOCK) in an image (h, w) of the samples around blobs: at (4, BLOCK) their x, y, variances xx, yy."""
    half = np.float32(0.5)
    for k in range(SAMPLES):
        for i in range(BLOCK):
            rx = np.float32(3.2) * np.sqrt(at[2, i]) + np.float32(1.5)
            ry = np.float32(3.2) * np.sqrt(at[3, i]) + np.float32(1.5)
            x = np.int32(at[0, i] + rx * circle[k, 0] + half)
            y = np.int32(at[1, i] + ry * circle[k, 1] + half)
            inside = (x >= 1) & (y >= 1) & (x < w - 1) & (y < h - 1)
            place[k, i] = y * w + x if inside else OUTSIDE


@compiled
def _rank(word, left, place, key):
    """What samples (S, BLOCK) are ranked by, int16: their height, of equal ones the earlier is the lower; or TAKEN."""
    for k in range(SAMPLES):
        for i in range(BLOCK):
            blue, green, red = word[k, i] & 255, (word[k, i] >> 8) & 255, (word[k, i] >> 16) & 255
            value = np.int16(max(max(blue, green), red))
            free = (left[k, i] > 0) | ((value == 0) & (place[k, i] != OUTSIDE))
            key[k, i] = np.int16(SAMPLES) * value + np.int16(k) if free else TAKEN


@compiled
def _mean_of_lowest(word, key, sums):
    """Of the lower three quarters of samples (S, BLOCK): mean B, G, R, variance of a channel, number (5, BLOCK)."""
    kept, before = np.zeros(BLOCK, np.int16), np.empty(BLOCK, np.int16)
    for k in range(SAMPLES):
        for i in range(BLOCK):
            kept[i] += np.int16(key[k, i] < TAKEN)
    for i in range(BLOCK):
        kept[i] -= kept[i] >> 2
    sums[:] = 0
    for k in range(SAMPLES):
        before[:] = 0
        for j in range(SAMPLES):
            for i in range(BLOCK):
                before[i] += np.int16(key[j, i] < key[k, i])
        for i in range(BLOCK):
            use = np.float32(before[i] < kept[i])
            blue, green, red = channels(word[k, i])
            sums[0, i] += use * blue
            sums[1, i] += use * green
            sums[2, i] += use * red
            sums[3, i] += use * (blue * blue + green * green + red * red)
    for i in range(BLOCK):
        sums[4, i] = np.float32(kept[i])
        r = np.float32(1) / max(sums[4, i], np.float32(1))
        blue, green, red = sums[0, i] * r, sums[1, i] * r, sums[2, i] * r
        sums[3, i] = (sums[3, i] * r - blue * blue - green * green - red * red) * np.float32(1 / 3)
        sums[0, i], sums[1, i], sums[2, i] = blue, green, red
