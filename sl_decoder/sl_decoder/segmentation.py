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
HIGHEST = 255  # value of a pixel
LANES = 16  # pixels of a blob are summed in groups of this many


@dataclass(frozen=True)
class Segments:
    """A segmented image with N blobs.

    smooth (3, H, W) uint8: planes of the image under the 3x3 binomial filter that removes the mosaic's frequency;
    colour (H, W) uint32 what stands above the background, packed (see `planes.top_hat`); rest (H, W) uint8 its largest
    channel where no blob is; pixels (P,) int32 the blobs' pixels, 65536 y + x, blob by blob, with room for LANES behind
    the last, start (N + 1,) int32 where each blob's begin; peak, floor (N,) float32 height of the blob and of the
    background around it in the largest channel.
    """

    smooth: NDArray[np.uint8]
    colour: NDArray[np.uint32]
    rest: NDArray[np.uint8]
    pixels: NDArray[np.int32]
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
def flood(hat, level, threshold, maximum, pixels, height, start, peak, base):
    """Blobs around the maxima of the top-hat.

    From every local maximum, pixels connected above SADDLE_RATIO of its height belong to the same dot, whatever small
    maxima they hold; from there the blob runs downhill (never up again) to FOOT_RATIO of its height. maximum (H, W)
    uint8: where to start. Sets hat to zero in the blobs, which is how a pixel is known to be taken, and along the
    border of the image, so that nobody needs to look for that. Writes the pixels, 65536 y + x, int32 and their height
    uint8 blob by blob; start, peak, base per blob. Returns the number of blobs.
    """
    h, w = hat.shape
    hat[0], hat[h - 1], hat[:, 0], hat[:, w - 1] = 0, 0, 0, 0
    n = 0
    end = 0
    flat = hat.ravel()
    begin = maximum.ravel()
    around = (-w - 1, -w, -w + 1, -1, 1, w - 1, w, w + 1)
    beside = (-65537, -65536, -65535, -1, 1, 65535, 65536, 65537)  # the same in packed coordinates
    chunks = begin[: len(begin) // 8 * 8].view(np.uint64)
    for chunk in range(len(chunks) + 1):
        if chunk < len(chunks) and chunks[chunk] == 0:
            continue
        for i in range(8 * chunk, min(8 * chunk + 8, len(begin))):
            if begin[i] == 0 or flat[i] == 0 or n >= len(peak):
                continue
            y = i // w
            x = i - y * w
            floor = level[y // BLOCK, x // BLOCK]
            least = threshold[y // BLOCK, x // BLOCK]
            top = np.int64(flat[i])
            join, low = _limits(top, floor, least)
            first_join, first_low = join, low
            first = head = end
            pixels[end] = (y << 16) + x
            height[end] = flat[i]
            flat[i] = 0
            end += 1
            while head < end:
                place = np.int64(pixels[head])
                j = (place >> 16) * w + (place & 0xFFFF)
                own = np.int64(height[head])
                head += 1
                if own < low:
                    continue
                # around the dot's core everything follows, else what is no higher
                span = np.uint64((HIGHEST if own >= join else own) - low)
                for step in range(8):
                    k = j + around[step]
                    v = np.int64(flat[k])
                    if np.uint64(v - low) <= span:
                        flat[k] = 0
                        pixels[end] = place + beside[step]
                        height[end] = v
                        end += 1
                        if v > top:
                            top = v
                            join, low = _limits(top, floor, least)
                            span = np.uint64(HIGHEST - low)
            if low > first_low:
                end = _give_back(hat, min(low, first_join), pixels, height, first, end)
            start[n] = first
            peak[n] = np.float32(top)
            base[n] = floor
            n += 1
    start[n] = end
    return n


@compiled
def _limits(top, floor, least):
    """From which height on what is connected is the same dot, and from which on it belongs to the blob at all."""
    above = np.float32(top) - floor
    join = np.int64(np.ceil(floor + np.float32(SADDLE_RATIO) * above))
    low = np.int64(max(floor + np.float32(FOOT_RATIO) * above, np.float32(least))) + 1
    return join, min(low, join)


@compiled
def _give_back(hat, low, pixels, height, first, end):
    """Give back the pixels below `low`, of a blob that is higher than where it began; returns where it now ends."""
    keep = first
    for k in range(first, end):
        place = pixels[k]
        if height[k] < low:
            hat[place >> 16, place & 0xFFFF] = height[k]
        else:
            pixels[keep] = place
            keep += 1
    return keep


def segment(bgr: NDArray[np.uint8], kernel: int) -> Segments:
    """Blobs of an image (H, W, 3) uint8.

    kernel: side of the opening [px], wider than a dot and not much wider than the dots' distance.
    """
    smooth = smoothed(bgr)
    h, w = bgr.shape[:2]
    hat = np.empty((h, w), np.uint8)
    colour = np.empty((h, w), np.uint32)
    top_hat(smooth, background(smooth, kernel), hat, colour)
    shape = (-(-h // BLOCK), -(-w // BLOCK))
    level = np.empty(shape, np.float32)
    threshold = np.empty(shape, np.uint8)
    measure_noise(hat, NOISE_FACTOR, level, threshold)
    maximum = np.empty((h, w), np.uint8)
    mark_maxima(hat, threshold, BLOCK, maximum)
    pixels = np.empty(h * w + LANES, np.int32)
    height = np.empty(h * w, np.uint8)
    start = np.empty(MAX_BLOBS + 1, np.int32)
    peak = np.empty(MAX_BLOBS, np.float32)
    floor = np.empty(MAX_BLOBS, np.float32)
    n = flood(hat, level, threshold, maximum, pixels, height, start, peak, floor)
    return Segments(smooth, colour, hat, pixels, start[: n + 1], peak[:n], floor[:n])
