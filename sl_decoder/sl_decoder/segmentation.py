"""Segmentation: a camera image to blobs, with background, threshold and separation that adapt to the image everywhere.

The background of every channel is its morphological opening (whatever is wider than a dot stays, dots vanish), so ambient
light, its colour and albedo steps drop out. What remains, the largest channel of the white top-hat, is split into
catchment basins of its maxima; basins whose saddle is nearly as high as their lower peak are one dot (noise, mosaic
artefacts), all others stay apart however close they lie (paper, section III.B: blob detection on the V channel).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

BLOCK = 32  # side of the squares in which noise is measured [px]
SADDLE_RATIO = 0.8  # basins that meet higher than this share of the lower peak are one dot
NOISE_FACTOR = 4.0  # a dot's pixels stand this many standard deviations above the background
MAX_BLOBS = 30000


@dataclass(frozen=True)
class Segments:
    """A segmented image with N blobs.

    signal (H, W, 3) uint8: image above its background, under the 3x3 binomial filter that removes the mosaic's frequency;
    hat (H, W) uint8 its largest channel; label (H, W) int32 blob index + 1 or 0; pixels (P,) int32 flat indices sorted by
    blob, start (N + 1,) int32 where each blob's begin; peak, floor (N,) float32 height of the blob and of the background
    around it in `hat`; saturation (H, W) uint8 largest channel of the smoothed image.
    """

    signal: NDArray[np.uint8]
    smooth: NDArray[np.uint8]
    hat: NDArray[np.uint8]
    label: NDArray[np.int32]
    pixels: NDArray[np.int32]
    start: NDArray[np.int32]
    peak: NDArray[np.float32]
    floor: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.peak)


@njit(cache=True)
def measure_noise(hat, factor, floor, threshold):  # type: ignore[no-untyped-def]
    """Level and threshold of the background per block, from low percentiles (dots cover the smaller part)."""
    h, w = hat.shape
    ny, nx = floor.shape
    low = np.empty((ny, nx), np.float32)
    deviation = np.empty((ny, nx), np.float32)
    hist = np.empty(256, np.int32)
    for by in range(ny):
        for bx in range(nx):
            hist[:] = 0
            n = 0
            for y in range(by * BLOCK, min(h, (by + 1) * BLOCK), 2):
                for x in range(bx * BLOCK, min(w, (bx + 1) * BLOCK), 2):
                    hist[hat[y, x]] += 1
                    n += 1
            acc = 0
            q5 = np.float32(-1.0)
            q35 = np.float32(-1.0)
            for value in range(256):
                if hist[value] == 0:
                    continue
                before = acc
                acc += hist[value]
                if q5 < 0 and acc >= 0.05 * n:
                    q5 = np.float32(value - 0.5 + (0.05 * n - before) / hist[value])
                if acc >= 0.35 * n:
                    q35 = np.float32(value - 0.5 + (0.35 * n - before) / hist[value])
                    break
            low[by, bx] = q35
            deviation[by, bx] = max((q35 - q5) / 1.26, 0.5)
    for by in range(ny):
        for bx in range(nx):
            a = np.float32(0)
            b = np.float32(0)
            n = 0
            for y in range(max(0, by - 1), min(ny, by + 2)):
                for x in range(max(0, bx - 1), min(nx, bx + 2)):
                    k = 2 if (y == by and x == bx) else 1
                    a += low[y, x] * k
                    b += deviation[y, x] * k
                    n += k
            floor[by, bx] = a / n
            threshold[by, bx] = a / n + max(3.0, factor * b / n)


@njit(cache=True, inline="always")
def _find(parent, i):  # type: ignore[no-untyped-def]
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True)
def ascend(hat, threshold, label, pixels):  # type: ignore[no-untyped-def]
    """Point every pixel above threshold to the highest of its 3x3 neighbourhood: label = -(target + 1), 0 elsewhere.

    Ties go to the later pixel, so that the pointers never form a cycle. Returns how many `pixels` were listed.
    """
    h, w = hat.shape
    n = 0
    capacity = len(pixels)
    limits = np.empty(w, np.uint8)
    for x in range(w):
        label[0, x] = 0
        label[h - 1, x] = 0
    for y in range(1, h - 1):
        if y == 1 or y % BLOCK == 0:
            for x in range(w):
                limits[x] = np.uint8(min(255.0, threshold[y // BLOCK, x // BLOCK]))
        label[y, 0] = 0
        label[y, w - 1] = 0
        above, here, below = hat[y - 1], hat[y], hat[y + 1]
        for x in range(1, w - 1):
            value = here[x]
            if value <= limits[x] or n >= capacity:
                label[y, x] = 0
                continue
            # value and place of the neighbour in one number: branchless maximum, later places win ties
            best = (np.int32(above[x - 1]) << 4)
            best = max(best, (np.int32(above[x]) << 4) | 1)
            best = max(best, (np.int32(above[x + 1]) << 4) | 2)
            best = max(best, (np.int32(here[x - 1]) << 4) | 3)
            best = max(best, (np.int32(value) << 4) | 4)
            best = max(best, (np.int32(here[x + 1]) << 4) | 5)
            best = max(best, (np.int32(below[x - 1]) << 4) | 6)
            best = max(best, (np.int32(below[x]) << 4) | 7)
            best = max(best, (np.int32(below[x + 1]) << 4) | 8)
            place = best & 15
            row = place // 3
            i = y * w + x
            label[y, x] = -(i + (row - 1) * w + (place - 3 * row - 1)) - 1
            pixels[n] = i
            n += 1
    return n


@njit(cache=True)
def collect_basins(hat, floor, label, pixels, n_pixels, saddle_ratio, max_basins):  # type: ignore[no-untyped-def]
    """Follow the pointers of `ascend` to basins and merge basins over high saddles.

    Rewrites label to blob index + 1. Returns the pixels sorted by blob, where each blob starts, peaks and floors.
    """
    h, w = hat.shape
    flat = label.ravel()
    values = hat.ravel()
    peak = np.empty(max_basins, np.float32)
    base = np.empty(max_basins, np.float32)
    n = 0
    for k in range(n_pixels):
        i = pixels[k]
        j = i
        while flat[j] < 0 and -flat[j] - 1 != j:
            j = -flat[j] - 1
        if flat[j] < 0:
            if n < max_basins:
                peak[n] = values[j]
                base[n] = floor[(j // w) // BLOCK, (j % w) // BLOCK]
                n += 1
                found = n
            else:
                found = 0
            flat[j] = found
        else:
            found = flat[j]
        j = i
        while flat[j] < 0:
            to = -flat[j] - 1
            flat[j] = found
            j = to
    parent = np.arange(n)
    around = (-w - 1, -w, -w + 1, -1, 1, w - 1, w, w + 1)
    for k in range(n_pixels):
        i = pixels[k]
        a = flat[i]
        if a == 0:
            continue
        a -= 1
        enough = base[a] + saddle_ratio * (peak[a] - base[a])
        if values[i] < enough:
            continue
        for step in around:
            b = flat[i + step] - 1
            if b >= 0 and b != a and values[i + step] >= enough:
                ra = _find(parent, a)
                rb = _find(parent, b)
                if ra != rb:
                    if peak[ra] < peak[rb]:
                        ra, rb = rb, ra
                    low = min(values[i], values[i + step])
                    if low - base[rb] >= saddle_ratio * (peak[rb] - base[rb]):
                        parent[rb] = ra
    index = np.full(n, -1, np.int32)
    m = 0
    for i in range(n):
        if parent[i] == i:
            peak[m] = peak[i]
            base[m] = base[i]
            index[i] = m
            m += 1
    for i in range(n):
        index[i] = index[_find(parent, i)]
    start = np.zeros(m + 2, np.int32)
    for k in range(n_pixels):
        i = pixels[k]
        if flat[i] > 0:
            j = index[flat[i] - 1] + 1
            flat[i] = j
            start[j + 1] += 1
    for j in range(m):
        start[j + 2] += start[j + 1]
    ordered = np.empty(start[m + 1], np.int32)
    for k in range(n_pixels):
        i = pixels[k]
        j = flat[i]
        if j > 0:
            ordered[start[j]] = i
            start[j] += 1
    return ordered, start[: m + 1], peak[:m].copy(), base[:m].copy()


def above_background(bgr: NDArray[np.uint8], kernel: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8]]:
    """Image (H, W, 3) above its background: (H, W, 3) uint8 signal, (H, W) its largest channel, (H, W, 3) smoothed.

    kernel: side of the opening [px]; the background is found at half resolution.
    """
    h, w = bgr.shape[:2]
    smooth = cv2.GaussianBlur(bgr, (3, 3), 0)
    half = cv2.resize(smooth, ((w + 1) // 2, (h + 1) // 2), interpolation=cv2.INTER_AREA)
    side = max(3, (kernel // 2) | 1)
    half = cv2.morphologyEx(half, cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    signal = cv2.subtract(smooth, cv2.resize(half, (w, h), interpolation=cv2.INTER_NEAREST))
    blue, green, red = cv2.split(signal)
    return signal, cv2.max(cv2.max(blue, green), red), smooth


def segment(bgr: NDArray[np.uint8], kernel: int) -> Segments:
    """Blobs of an image (H, W, 3) uint8.

    kernel: side of the opening [px], wider than a dot and not much wider than the dots' distance.
    """
    signal, hat, smooth = above_background(bgr, kernel)
    h, w = hat.shape
    shape = (-(-h // BLOCK), -(-w // BLOCK))
    level = np.empty(shape, np.float32)
    threshold = np.empty(shape, np.float32)
    measure_noise(hat, NOISE_FACTOR, level, threshold)
    label = np.empty((h, w), np.int32)
    pixels = np.empty(h * w // 2 + 16, np.int32)
    n = ascend(hat, threshold, label, pixels)
    ordered, start, peak, floor = collect_basins(hat, level, label, pixels, n, SADDLE_RATIO, MAX_BLOBS)
    return Segments(signal, smooth, hat, label, ordered, start, peak, floor)
