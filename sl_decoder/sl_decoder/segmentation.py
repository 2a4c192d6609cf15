"""Segmentation: a camera image to blobs, with a threshold, a background and a scale that adapt to the image.

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

BLOCK = 32  # side of the squares in which noise is measured [px]
SADDLE_RATIO = 0.8  # basins meeting higher than this share of the lower peak are one dot
NOISE_FACTOR = 4.0  # a dot's peak stands this many standard deviations above the background


@dataclass(frozen=True)
class Blobs:
    """Blobs of one image: N entries each.

    centre (N, 2) float32 intensity-weighted, px; peak (N,) float32 top-hat height, counts; floor (N,) float32 background
    level of the top-hat; area (N,) int32 pixels above half of the peak; covariance (N, 3) float32 xx, xy, yy of these
    pixels, px^2; saturated (N,) bool.
    """

    centre: np.ndarray
    peak: np.ndarray
    floor: np.ndarray
    area: np.ndarray
    covariance: np.ndarray

    def __len__(self) -> int:
        return len(self.peak)


@dataclass(frozen=True)
class Segments:
    """A segmented image: blobs, and per pixel (H, W) the top-hat uint8 and the label int32 (blob index + 1, 0 none);
    smooth (H, W, 3) uint8 is the image under the 3x3 binomial filter that removes the mosaic's frequency."""

    blobs: Blobs
    smooth: np.ndarray
    hat: np.ndarray
    label: np.ndarray


@njit(cache=True, boundscheck=False)
def _top_hat(smooth, background, out):  # type: ignore[no-untyped-def]
    h, w = out.shape
    for y in range(h):
        yb = min(y >> 1, background.shape[0] - 1)
        for x in range(w):
            xb = min(x >> 1, background.shape[1] - 1)
            a = np.int32(smooth[y, x, 0]) - np.int32(background[yb, xb, 0])
            b = np.int32(smooth[y, x, 1]) - np.int32(background[yb, xb, 1])
            c = np.int32(smooth[y, x, 2]) - np.int32(background[yb, xb, 2])
            m = max(a, max(b, c))
            out[y, x] = m if m > 0 else 0


@njit(cache=True, boundscheck=False)
def _noise(hat, floor, threshold, factor):  # type: ignore[no-untyped-def]
    """Floor and threshold per block from low percentiles of the top-hat (dots cover the smaller part)."""
    h, w = hat.shape
    ny, nx = floor.shape
    lo = np.empty((ny, nx), np.float32)
    sd = np.empty((ny, nx), np.float32)
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
            q5 = -1.0
            q35 = -1.0
            for v in range(256):
                if hist[v] == 0:
                    continue
                before = acc
                acc += hist[v]
                if q5 < 0 and acc >= 0.05 * n:
                    q5 = v - 0.5 + (0.05 * n - before) / hist[v]
                if q35 < 0 and acc >= 0.35 * n:
                    q35 = v - 0.5 + (0.35 * n - before) / hist[v]
                    break
            lo[by, bx] = q35
            sd[by, bx] = max((q35 - q5) / 1.26, 0.5)
    for by in range(ny):
        for bx in range(nx):
            a = np.float32(0)
            b = np.float32(0)
            n = 0
            for y in range(max(0, by - 1), min(ny, by + 2)):
                for x in range(max(0, bx - 1), min(nx, bx + 2)):
                    k = 2 if (y == by and x == bx) else 1
                    a += lo[y, x] * k
                    b += sd[y, x] * k
                    n += k
            floor[by, bx] = a / n
            threshold[by, bx] = a / n + max(3.0, factor * b / n)


@njit(cache=True, boundscheck=False)
def _find(parent, i):  # type: ignore[no-untyped-def]
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, boundscheck=False)
def _basins(hat, floor, threshold, label, pixels, peak, base, saddle_ratio):  # type: ignore[no-untyped-def]
    """Steepest-ascent basins of the pixels above threshold, merged over high saddles.

    label (H, W) int32 gets the index of the basin + 1, pixels the flat indices of all labelled pixels in raster order.
    Returns number of basins, number of pixels, parent (union-find over basins).
    """
    h, w = hat.shape
    n_pixels = 0
    capacity = len(pixels)
    # each pixel above threshold points to its highest neighbour
    for y in range(h):
        by = y // BLOCK
        for bx in range(threshold.shape[1]):
            t = threshold[by, bx]
            for x in range(bx * BLOCK, min(w, (bx + 1) * BLOCK)):
                v = hat[y, x]
                if v <= t or y == 0 or x == 0 or y == h - 1 or x == w - 1 or n_pixels >= capacity:
                    label[y, x] = 0
                    continue
                i = y * w + x
                best = v
                to = i
                if hat[y - 1, x - 1] > best:
                    best = hat[y - 1, x - 1]
                    to = i - w - 1
                if hat[y - 1, x] > best:
                    best = hat[y - 1, x]
                    to = i - w
                if hat[y - 1, x + 1] > best:
                    best = hat[y - 1, x + 1]
                    to = i - w + 1
                if hat[y, x - 1] > best:
                    best = hat[y, x - 1]
                    to = i - 1
                if hat[y, x + 1] >= best:
                    best = hat[y, x + 1]
                    to = i + 1
                if hat[y + 1, x - 1] >= best:
                    best = hat[y + 1, x - 1]
                    to = i + w - 1
                if hat[y + 1, x] >= best:
                    best = hat[y + 1, x]
                    to = i + w
                if hat[y + 1, x + 1] >= best:
                    best = hat[y + 1, x + 1]
                    to = i + w + 1
                label[y, x] = -to - 1
                pixels[n_pixels] = i
                n_pixels += 1
    flat = label.ravel()
    values = hat.ravel()
    n = 0
    limit = len(peak)
    for k in range(n_pixels):
        i = pixels[k]
        if flat[i] > 0:
            continue
        # climb to a root or to a labelled pixel, then label the path
        j = i
        while flat[j] < 0 and -flat[j] - 1 != j:
            j = -flat[j] - 1
        if flat[j] < 0:
            if n >= limit:
                flat[j] = 0
                found = 0
            else:
                peak[n] = values[j]
                base[n] = floor[(j // w) // BLOCK, (j % w) // BLOCK]
                n += 1
                found = n
                flat[j] = found
        else:
            found = flat[j]
        j = i
        while flat[j] < 0:
            to = -flat[j] - 1
            flat[j] = found
            j = to
    parent = np.arange(n)
    for k in range(n_pixels):
        i = pixels[k]
        a = flat[i]
        if a == 0:
            continue
        for step in (1, w - 1, w, w + 1):
            b = flat[i + step]
            if b > 0 and b != a:
                ra = _find(parent, a - 1)
                rb = _find(parent, b - 1)
                if ra != rb:
                    low = min(values[i], values[i + step])
                    if peak[ra] < peak[rb]:
                        ra, rb = rb, ra
                    if low - base[rb] >= saddle_ratio * (peak[rb] - base[rb]):
                        parent[rb] = ra
    return n, n_pixels, parent


@njit(cache=True, boundscheck=False)
def _measure(hat, label, pixels, n_pixels, n, parent, peak, base):  # type: ignore[no-untyped-def]
    w = hat.shape[1]
    values = hat.ravel()
    flat = label.ravel()
    index = np.full(n, -1, np.int32)
    m = 0
    for i in range(n):
        if parent[i] == i:
            index[i] = m
            m += 1
    for i in range(n):
        index[i] = index[_find(parent, i)]
    top = np.empty(m, np.float32)
    floor = np.empty(m, np.float32)
    for i in range(n):
        if parent[i] == i:
            top[index[i]] = peak[i]
            floor[index[i]] = base[i]
    total = np.zeros(m, np.float64)
    sx = np.zeros(m, np.float64)
    sy = np.zeros(m, np.float64)
    area = np.zeros(m, np.int32)
    for k in range(n_pixels):
        i = pixels[k]
        if flat[i] == 0:
            continue
        j = index[flat[i] - 1]
        flat[i] = j + 1
        v = values[i] - floor[j]
        p = top[j] - floor[j]
        if v < 0.5 * p:
            continue
        area[j] += 1
        total[j] += v
        y = i // w
        sx[j] += v * (i - y * w)
        sy[j] += v * y
    centre = np.empty((m, 2), np.float32)
    for j in range(m):
        centre[j, 0] = sx[j] / total[j]
        centre[j, 1] = sy[j] / total[j]
    cov = np.zeros((m, 3), np.float32)
    for k in range(n_pixels):
        i = pixels[k]
        if flat[i] == 0:
            continue
        j = flat[i] - 1
        v = values[i] - floor[j]
        if v < 0.5 * (top[j] - floor[j]):
            continue
        y = i // w
        dx = (i - y * w) - centre[j, 0]
        dy = y - centre[j, 1]
        cov[j, 0] += dx * dx
        cov[j, 1] += dx * dy
        cov[j, 2] += dy * dy
    for j in range(m):
        for c in range(3):
            cov[j, c] /= area[j]
        cov[j, 0] += 1.0 / 12.0
        cov[j, 2] += 1.0 / 12.0
    return centre, top, floor, area, cov


def top_hat(bgr: np.ndarray, kernel: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Largest channel above the background: image (H, W, 3) uint8, side of the opening [px].

    Returns top-hat (H, W) uint8, the smoothed image (H, W, 3) and the background at half resolution.
    """
    smooth = cv2.GaussianBlur(bgr, (3, 3), 0)
    half = cv2.resize(smooth, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    side = max(3, (kernel // 2) | 1)
    background = cv2.morphologyEx(half, cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    hat = np.empty(bgr.shape[:2], np.uint8)
    _top_hat(smooth, background, hat)
    return hat, smooth, background


def segment(bgr: np.ndarray, kernel: int, *, max_blobs: int = 20000) -> Segments:
    """Blobs of an image (H, W, 3) uint8; `kernel` is the side of the opening, a little more than a dot's width [px]."""
    hat, smooth, _ = top_hat(bgr, kernel)
    h, w = hat.shape
    shape = (-(-h // BLOCK), -(-w // BLOCK))
    floor = np.empty(shape, np.float32)
    threshold = np.empty(shape, np.float32)
    _noise(hat, floor, threshold, NOISE_FACTOR)
    label = np.empty((h, w), np.int32)
    pixels = np.empty(h * w // 2, np.int32)
    peak = np.empty(max_blobs, np.float32)
    base = np.empty(max_blobs, np.float32)
    n, n_pixels, parent = _basins(hat, floor, threshold, label, pixels, peak, base, SADDLE_RATIO)
    centre, top, low, area, cov = _measure(hat, label, pixels, n_pixels, n, parent, peak, base)
    return Segments(Blobs(centre, top, low, area, cov), smooth, hat, label)
