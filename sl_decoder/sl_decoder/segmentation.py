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

import numpy as np
from numpy.typing import NDArray

from sl_decoder.compiled import compiled
from sl_decoder.planes import background, mark_maxima, smoothed, top_hat

BLOCK = 32  # side of the squares in which noise is measured [px]
SADDLE_RATIO = 0.8  # maxima that connect above this share of their height are one dot
FOOT_RATIO = 0.2  # a blob's pixels reach down to this share of its height
NOISE_FACTOR = 4.0  # a dot's pixels stand this many standard deviations above the background
MAX_BLOBS = 30000


@dataclass(frozen=True)
class Segments:
    """A segmented image with N blobs.

    smooth (3, H, W) uint8: planes of the image under the 3x3 binomial filter that removes the mosaic's frequency;
    background (3, ceil(H / 2), ceil(W / 2)) uint8 at half resolution; hat (H, W) uint8 the largest channel of what
    stands above it; label (H, W) int16 blob index + 1 or 0; xs, ys (P,) int16 its pixels blob by blob, start (N + 1,)
    int32 where each blob's begin; peak, floor (N,) float32 height of the blob and of the background around it in `hat`.
    """

    smooth: NDArray[np.uint8]
    background: NDArray[np.uint8]
    hat: NDArray[np.uint8]
    label: NDArray[np.int16]
    xs: NDArray[np.int16]
    ys: NDArray[np.int16]
    start: NDArray[np.int32]
    peak: NDArray[np.float32]
    floor: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.peak)


@compiled
def measure_noise(hat, factor, floor, threshold):
    """Level (float32) and threshold (uint8) of the background per block, from low percentiles.

    Dots cover the smaller part.
    """
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
            threshold[by, bx] = np.uint8(min(254.0, a / n + max(3.0, factor * b / n)))


@compiled
def flood(hat, level, threshold, maximum, label, xs, ys, start, peak, base):
    """Blobs around the maxima of the top-hat.

    From every local maximum, pixels connected above SADDLE_RATIO of its height belong to the same dot, whatever small
    maxima they hold; from there the blob runs downhill (never up again) to FOOT_RATIO of its height. maximum (H, W)
    uint8: where to start. Writes label (H, W) int16 (must be zero) and the pixels' xs, ys int16 blob by blob; start,
    peak, base per blob. Returns the number of blobs.
    """
    h, w = hat.shape
    n = 0
    end = 0
    flat = hat.ravel()
    mark = label.ravel()
    begin = maximum.ravel()
    around = (-w - 1, -w, -w + 1, -1, 1, w - 1, w, w + 1)
    right = (-1, 0, 1, -1, 1, -1, 0, 1)
    down = (-1, -1, -1, 0, 0, 1, 1, 1)
    chunks = begin[: len(begin) // 8 * 8].view(np.uint64)
    for chunk in range(len(chunks) + 1):
        if chunk < len(chunks) and chunks[chunk] == 0:
            continue
        for i in range(8 * chunk, min(8 * chunk + 8, len(begin))):
            if begin[i] == 0 or mark[i] != 0 or n >= len(peak) or end + 64 > len(xs):
                continue
            y = i // w
            x = i - y * w
            floor = level[y // BLOCK, x // BLOCK]
            value = flat[i]
            n += 1
            first = end
            mark[i] = n
            xs[end] = x
            ys[end] = y
            end += 1
            join = np.ceil(floor + np.float32(SADDLE_RATIO) * (value - floor))
            head = first
            while head < end:
                px, py = xs[head], ys[head]
                head += 1
                if px <= 0 or py <= 0 or px >= w - 1 or py >= h - 1:
                    continue
                j = np.int64(py) * w + px
                for step in range(8):
                    k = j + around[step]
                    if flat[k] >= join and mark[k] == 0 and end < len(xs):
                        mark[k] = n
                        xs[end] = px + right[step]
                        ys[end] = py + down[step]
                        end += 1
                        if flat[k] > value:
                            value = flat[k]
                            join = np.ceil(floor + np.float32(SADDLE_RATIO) * (value - floor))
            top = np.float32(value)
            foot = max(floor + np.float32(FOOT_RATIO) * (top - floor), np.float32(threshold[y // BLOCK, x // BLOCK]))
            least = np.int64(foot)
            head = first
            while head < end:
                px, py = xs[head], ys[head]
                head += 1
                if px <= 0 or py <= 0 or px >= w - 1 or py >= h - 1:
                    continue
                j = np.int64(py) * w + px
                here = flat[j]
                for step in range(8):
                    k = j + around[step]
                    if least < flat[k] <= here and mark[k] == 0 and end < len(xs):
                        mark[k] = n
                        xs[end] = px + right[step]
                        ys[end] = py + down[step]
                        end += 1
            start[n - 1] = first
            peak[n - 1] = top
            base[n - 1] = floor
    start[n] = end
    return n


def segment(bgr: NDArray[np.uint8], kernel: int) -> Segments:
    """Blobs of an image (H, W, 3) uint8.

    kernel: side of the opening [px], wider than a dot and not much wider than the dots' distance.
    """
    smooth = smoothed(bgr)
    half = background(smooth, kernel)
    h, w = bgr.shape[:2]
    hat = np.empty((h, w), np.uint8)
    top_hat(smooth, half, hat)
    shape = (-(-h // BLOCK), -(-w // BLOCK))
    level = np.empty(shape, np.float32)
    threshold = np.empty(shape, np.uint8)
    measure_noise(hat, NOISE_FACTOR, level, threshold)
    maximum = np.empty((h, w), np.uint8)
    mark_maxima(hat, threshold, BLOCK, maximum)
    label = np.zeros((h, w), np.int16)
    capacity = h * w // 2 + 64
    xs = np.empty(capacity, np.int16)
    ys = np.empty(capacity, np.int16)
    start = np.empty(MAX_BLOBS + 1, np.int32)
    peak = np.empty(MAX_BLOBS, np.float32)
    floor = np.empty(MAX_BLOBS, np.float32)
    n = flood(hat, level, threshold, maximum, label, xs, ys, start, peak, floor)
    return Segments(smooth, half, hat, label, xs, ys, start[: n + 1], peak[:n], floor[:n])
