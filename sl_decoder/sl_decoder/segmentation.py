"""Segmentation: a camera image to blobs, with background, threshold and separation that adapt to the image everywhere.

The background of every channel is its morphological opening (whatever is wider than a dot stays, dots vanish), so
ambient light, its colour and albedo steps drop out. What remains, the largest channel of the white top-hat, is
flooded downhill from its maxima; maxima that connect at nearly their own height are one dot (noise, mosaic
artefacts), all others stay apart however close they lie (paper, section III.B: blob detection on the V channel).
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sl_decoder.compiled import compiled

BLOCK = 32  # side of the squares in which noise is measured [px]
SADDLE_RATIO = 0.8  # maxima that connect above this share of their height are one dot
FOOT_RATIO = 0.2  # a blob's pixels reach down to this share of its height
NOISE_FACTOR = 4.0  # a dot's pixels stand this many standard deviations above the background
MAX_BLOBS = 30000


@dataclass(frozen=True)
class Segments:
    """A segmented image with N blobs.

    signal (H, W, 3) uint8: image above its background, under the 3x3 binomial filter that removes the mosaic's
    frequency; hat (H, W) uint8 its largest channel; label (H, W) int32 blob index + 1 or 0; xs, ys (P,) int16 its
    pixels blob by blob, start (N + 1,) int32 where each blob's begin; peak, floor (N,) float32 height of the blob and
    of the background around it in `hat`; smooth (H, W, 3) uint8 the filtered image itself.
    """

    signal: NDArray[np.uint8]
    smooth: NDArray[np.uint8]
    hat: NDArray[np.uint8]
    label: NDArray[np.int32]
    xs: NDArray[np.int16]
    ys: NDArray[np.int16]
    start: NDArray[np.int32]
    peak: NDArray[np.float32]
    floor: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.peak)


@compiled
def measure_noise(hat, factor, floor, threshold):
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


@compiled
def flood(hat, level, threshold, label, xs, ys, start, peak, base):
    """Blobs around the maxima of the top-hat.

    From every local maximum, pixels connected above SADDLE_RATIO of its height belong to the same dot, whatever small
    maxima they hold; from there the blob runs downhill (never up again) to FOOT_RATIO of its height. Writes label (H,
    W) int32 (must be zero) and the pixels' xs, ys int16 blob by blob; start, peak, base per blob. Returns the number
    of blobs.
    """
    h, w = hat.shape
    capacity = len(xs)
    most = len(peak)
    n = 0
    end = 0
    limits = np.empty(w, np.uint8)
    flat = hat.ravel()
    mark = label.ravel()
    around = (-w - 1, -w, -w + 1, -1, 1, w - 1, w, w + 1)
    for y in range(1, h - 1):
        if y == 1 or y % BLOCK == 0:
            for x in range(w):
                limits[x] = np.uint8(min(254.0, threshold[y // BLOCK, x // BLOCK]))
        row = y * w
        for x in range(1, w - 1):
            i = row + x
            value = flat[i]
            if value <= limits[x] or mark[i] != 0:
                continue
            # a maximum; of a plateau, its last pixel
            if not (
                value >= flat[i - 1]
                and value > flat[i + 1]
                and value >= flat[i - w]
                and value > flat[i + w]
                and value >= flat[i - w - 1]
                and value >= flat[i - w + 1]
                and value > flat[i + w - 1]
                and value > flat[i + w + 1]
            ):
                continue
            if n >= most or end + 64 > capacity:
                break
            floor = np.float32(level[y // BLOCK, x // BLOCK])
            top = np.float32(value)
            n += 1
            first = end
            mark[i] = n
            xs[end] = x
            ys[end] = y
            end += 1
            join = floor + np.float32(SADDLE_RATIO) * (top - floor)
            head = first
            while head < end:
                px, py = xs[head], ys[head]
                head += 1
                if px <= 0 or py <= 0 or px >= w - 1 or py >= h - 1:
                    continue
                j = np.int64(py) * w + px
                for step in around:
                    k = j + step
                    if mark[k] == 0 and flat[k] >= join and end < capacity:
                        mark[k] = n
                        yy = k // w
                        xs[end] = k - yy * w
                        ys[end] = yy
                        end += 1
                        if flat[k] > top:
                            top = np.float32(flat[k])
                            join = floor + np.float32(SADDLE_RATIO) * (top - floor)
            foot = max(floor + np.float32(FOOT_RATIO) * (top - floor), np.float32(limits[x]))
            head = first
            while head < end:
                px, py = xs[head], ys[head]
                head += 1
                if px <= 0 or py <= 0 or px >= w - 1 or py >= h - 1:
                    continue
                j = np.int64(py) * w + px
                here = flat[j]
                for step in around:
                    k = j + step
                    value_k = flat[k]
                    if value_k > foot and value_k <= here and mark[k] == 0 and end < capacity:
                        mark[k] = n
                        yy = k // w
                        xs[end] = k - yy * w
                        ys[end] = yy
                        end += 1
            start[n - 1] = first
            peak[n - 1] = top
            base[n - 1] = floor
    start[n] = end
    return n


def smoothed(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Image (H, W, 3) uint8 under the 3x3 binomial filter, which removes the frequency of a Bayer mosaic."""
    return cv2.GaussianBlur(bgr, (3, 3), 0)


def above_background(
    bgr: NDArray[np.uint8], kernel: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.uint8]]:
    """Image (H, W, 3) above its background: (H, W, 3) uint8 signal, (H, W) its largest channel, (H, W, 3) smoothed.

    kernel: side of the opening [px]; the background is found at half resolution.
    """
    h, w = bgr.shape[:2]
    smooth = smoothed(bgr)
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
    label = np.zeros((h, w), np.int32)
    capacity = h * w // 2 + 64
    xs = np.empty(capacity, np.int16)
    ys = np.empty(capacity, np.int16)
    start = np.empty(MAX_BLOBS + 1, np.int32)
    peak = np.empty(MAX_BLOBS, np.float32)
    floor = np.empty(MAX_BLOBS, np.float32)
    n = flood(hat, level, threshold, label, xs, ys, start, peak, floor)
    return Segments(signal, smooth, hat, label, xs, ys, start[: n + 1], peak[:n], floor[:n])
