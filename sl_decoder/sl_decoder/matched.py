"""Measurement of a dot where one is expected: around a predicted place, with a known shape and letter colour.

Knowing where to look, what shape and which mixture of channels to expect lets a dot be found that is too faint to stand
out of the noise by itself, that merged with its neighbour, or that merely moved since the last image.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.compiled import compiled
from sl_decoder.planes import SATURATED

WEIGHT = 2.6  # the weight is zero at this many times the size of the core
LEAST_CONTRAST = 2.5  # standard deviations that a dot's mean must stand above its background
LANES = 8  # pixels that are summed at once

SAMPLES = 16
WORK = 3 + 4 * SAMPLES + 65536
"""Numbers that `measure_at` needs to work with: for windows of up to 256 by 256 pixels."""

_ANGLE = np.arange(SAMPLES) * (2 * np.pi / SAMPLES)
CIRCLE = np.stack([np.cos(_ANGLE), np.sin(_ANGLE)], 1).astype(np.float32)


@compiled
def _surroundings(smooth, px, py, sx, sy, mix, circle, ring, back):
    """Background around a dot at (px, py): mean (3,) of the darker half of the samples on the ellipse (sx, sy).

    Neighbouring dots may cover the others. ring (4, S) float32: work space. Returns the background's noise and the
    level of its darker quarter under the mixture `mix`.
    """
    n = SAMPLES
    order = np.empty(SAMPLES, np.int32)
    for k in range(n):
        x = int(px + sx * circle[k, 0] + np.float32(0.5))
        y = int(py + sy * circle[k, 1] + np.float32(0.5))
        p0, p1, p2 = np.float32(smooth[0, y, x]), np.float32(smooth[1, y, x]), np.float32(smooth[2, y, x])
        ring[1, k], ring[2, k], ring[3, k] = p0, p1, p2
        # distinct keys: equal values keep their order
        ring[0, k] = mix[0] * p0 + mix[1] * p1 + mix[2] * p2 + np.float32(k) * np.float32(1e-3)
    for k in range(SAMPLES):
        before = np.int32(0)
        for j in range(SAMPLES):
            before += np.int32(ring[0, j] < ring[0, k])
        order[k] = before
    half = n >> 1
    b0 = b1 = b2 = lowest = quarter = middle = np.float32(0)
    for k in range(n):
        value = ring[0, k]
        before = order[k]
        use = np.float32(before < half)
        b0 += use * ring[1, k]
        b1 += use * ring[2, k]
        b2 += use * ring[3, k]
        lowest = value if before == 0 else lowest
        quarter = value if before == half >> 1 else quarter
        middle = value if before == half else middle
    back[0], back[1], back[2] = b0 / half, b1 / half, b2 / half
    # the lower half's mean lies 0.8 sigma below, its span to the median is about 2 sigma of 16 samples
    return max((middle - lowest) / np.float32(1.9), np.float32(0.6)), quarter


@compiled
def measure_at(smooth, px, py, cxx, cxy, cyy, mix, ax, ay, bx, by, reach, circle, work, out):
    """Find and measure the dot near (px, py).

    smooth (3, H, W) uint8; cxx, cxy, cyy expected core covariance [px^2]; mix (3,) expected share of the channels; a, b
    local lattice basis [px], in which `reach` bounds the search; circle (S, 2); work (WORK,) float32. out (7,) float32
    gets x, y, B, G, R above the background, their noise, and the share of saturated core pixels. Returns False where no
    dot stands out.
    """
    h, w = smooth.shape[1], smooth.shape[2]
    one, zero = np.float32(1), np.float32(0)
    px, py = np.float32(px), np.float32(py)
    cxx, cxy, cyy = np.float32(cxx), np.float32(cxy), np.float32(cyy)
    ax, ay, bx, by = np.float32(ax), np.float32(ay), np.float32(bx), np.float32(by)
    det_ab = ax * by - ay * bx
    if det_ab <= np.float32(1e-3):
        return False
    deviation_x, deviation_y = np.sqrt(cxx), np.sqrt(cyy)
    sx = np.float32(3.2) * deviation_x + np.float32(1.5)
    sy = np.float32(3.2) * deviation_y + np.float32(1.5)
    if not (sx <= px < w - sx - 1 and sy <= py < h - sy - 1):
        return False
    n = len(circle)
    back = work[:3]
    sigma, dark = _surroundings(smooth, px, py, sx, sy, mix, circle, work[3 : 3 + 4 * n].reshape((4, n)), back)
    w0, w1, w2 = mix[0], mix[1], mix[2]
    # the mixture over all that the search and the weights around any place it may find can touch
    rx = int(reach * (abs(ax) + abs(bx)) + np.float32(0.5))
    ry = int(reach * (abs(ay) + abs(by)) + np.float32(0.5))
    hx = np.float32(WEIGHT) * deviation_x
    hy = np.float32(WEIGHT) * deviation_y
    cx0, cy0 = int(px + np.float32(0.5)), int(py + np.float32(0.5))
    left, right = max(0, cx0 - rx - int(hx) - 1), min(w, cx0 + rx + int(hx) + 2)
    top, bottom = max(0, cy0 - ry - int(hy) - 1), min(h, cy0 + ry + int(hy) + 2)
    stride = (right - left + LANES - 1) // LANES * LANES
    left = max(0, min(left, w - stride))
    cols = min(stride, w - left)
    if (bottom - top) * stride > len(work) - 3 - 4 * n:
        return False
    window = work[3 + 4 * n : 3 + 4 * n + (bottom - top) * stride].reshape((bottom - top, stride))
    for y in range(top, bottom):
        blue, green, red = smooth[0, y, left:], smooth[1, y, left:], smooth[2, y, left:]
        to = window[y - top]
        for x in range(cols):
            to[x] = w0 * np.float32(blue[x]) + w1 * np.float32(green[x]) + w2 * np.float32(red[x])
        to[cols:] = zero
    # search: the highest place near the prediction
    best = np.float32(-1e9)
    mx, my = px, py
    scale = one / (det_ab * reach)
    for y in range(max(1, cy0 - ry), min(h - 1, cy0 + ry + 1)):
        ey = (np.float32(y) - py) * scale
        row = window[y - top]
        for x in range(max(1, cx0 - rx), min(w - 1, cx0 + rx + 1)):
            ex = (np.float32(x) - px) * scale
            s = ex * by - ey * bx
            t = ax * ey - ay * ex
            r2 = s * s + t * t
            value = (row[x - left] - dark) * (one - np.float32(0.5) * r2)
            if value > best and (r2 <= one or (x == cx0 and y == cy0)):
                best = value
                mx, my = np.float32(x), np.float32(y)
    offset = w0 * back[0] + w1 * back[1] + w2 * back[2]
    det = max(cxx * cyy - cxy * cxy, np.float32(1e-3))
    norm = one / (det * np.float32(WEIGHT * WEIGHT))
    ixx, ixy, iyy = cyy * norm, -2 * cxy * norm, cxx * norm
    for _ in range(4):
        x0 = max(left, min(left + stride - LANES, int(mx - hx)))
        x1 = min(left + stride, x0 + (int(mx + hx) + LANES - x0) // LANES * LANES)
        tx = ty = total = zero
        for y in range(max(top, int(my - hy + one)), min(bottom - 1, int(my + hy)) + 1):
            dy = np.float32(y) - my
            row = window[y - top, x0 - left : x1 - left]
            start = np.float32(x0) - mx
            a0 = one - iyy * dy * dy
            a1 = ixy * dy
            for x in range(len(row)):
                dx = np.float32(x) + start
                g = max(a0 - dx * (a1 + ixx * dx), zero)
                g = g * g * (row[x] - offset)
                total += g
                tx += g * dx
                ty += g * dy
        if total <= 0:
            return False
        tx = np.float32(1.5) * tx / total
        ty = np.float32(1.5) * ty / total
        mx += tx
        my += ty
        if tx * tx + ty * ty < np.float32(1e-4):
            break
    ex, ey = (mx - px) * scale, (my - py) * scale
    s = ex * by - ey * bx
    t = ax * ey - ay * ex
    if s * s + t * t > one:
        return False
    # colour: mean over the core (the ellipse of two standard deviations, which a disc fills)
    hx = np.float32(2.0) * deviation_x
    hy = np.float32(2.0) * deviation_y
    norm = np.float32(0.25) / det
    ixx, ixy, iyy = cyy * norm, -2 * cxy * norm, cxx * norm
    c0 = c1 = c2 = m = saturated = zero
    x0, x1 = max(0, int(mx - hx + one)), min(w - 1, int(mx + hx)) + 1
    start = np.float32(x0) - mx
    for y in range(max(0, int(my - hy + one)), min(h - 1, int(my + hy)) + 1):
        dy = np.float32(y) - my
        blue, green, red = smooth[0, y, x0:x1], smooth[1, y, x0:x1], smooth[2, y, x0:x1]
        a0 = one - iyy * dy * dy
        a1 = ixy * dy
        for x in range(len(blue)):
            dx = np.float32(x) + start
            use = one if dx * (a1 + ixx * dx) <= a0 else zero
            p0, p1, p2 = np.float32(blue[x]), np.float32(green[x]), np.float32(red[x])
            c0 += use * p0
            c1 += use * p1
            c2 += use * p2
            m += use
            saturated += use if max(max(p0, p1), p2) >= SATURATED else zero
    if m == 0:
        return False
    out[0] = mx
    out[1] = my
    out[2] = c0 / m - back[0]
    out[3] = c1 / m - back[1]
    out[4] = c2 / m - back[2]
    spread = sigma * np.sqrt(one / np.float32(n >> 1) + one / max(one, m / np.float32(3)))
    out[5] = spread
    out[6] = saturated / m
    return w0 * out[2] + w1 * out[3] + w2 * out[4] > np.float32(LEAST_CONTRAST) * spread
