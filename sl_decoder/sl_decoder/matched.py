"""Measurement of a dot where one is expected: around a predicted place, with a known shape and letter colour.

Knowing where to look, what shape and which mixture of channels to expect lets a dot be found that is too faint to stand
out of the noise by itself, that merged with its neighbour, or that merely moved since the last image.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.compiled import compiled

WEIGHT = 2.6  # the weight is zero at this many times the size of the core
LEAST_CONTRAST = 2.5  # standard deviations that a dot's mean must stand above its background

SAMPLES = 16
_ANGLE = np.arange(SAMPLES) * (2 * np.pi / SAMPLES)
CIRCLE = np.stack([np.cos(_ANGLE), np.sin(_ANGLE)], 1).astype(np.float32)


@compiled
def measure_at(smooth, px, py, cxx, cxy, cyy, mix, ax, ay, bx, by, reach, circle, out):
    """Find and measure the dot near (px, py).

    smooth (H, W, 3) uint8; cxx, cxy, cyy expected core covariance [px^2]; mix (3,) expected share of the channels; a, b
    local lattice basis [px], in which `reach` bounds the search; circle (S, 2). out (7,) float32 gets x, y, B, G, R
    above the background, their noise, and the share of saturated core pixels. Returns False where no dot stands out.
    """
    h, w = smooth.shape[0], smooth.shape[1]
    one = np.float32(1)
    zero = np.float32(0)
    det_ab = ax * by - ay * bx
    if det_ab <= 1e-3:
        return False
    sx = np.float32(3.2) * np.sqrt(cxx) + np.float32(1.5)
    sy = np.float32(3.2) * np.sqrt(cyy) + np.float32(1.5)
    if px < sx or py < sy or px >= w - sx - 1 or py >= h - sy - 1:
        return False
    w0, w1, w2 = mix[0], mix[1], mix[2]
    # background: the darker half of the samples on an ellipse around, neighbouring dots may cover the others
    n = len(circle)
    order = np.empty(SAMPLES, np.float32)
    place = np.empty(SAMPLES, np.int32)
    for k in range(n):
        x = int(px + sx * circle[k, 0] + 0.5)
        y = int(py + sy * circle[k, 1] + 0.5)
        value = w0 * smooth[y, x, 0] + w1 * smooth[y, x, 1] + w2 * smooth[y, x, 2]
        p = k
        while p > 0 and order[p - 1] > value:
            order[p] = order[p - 1]
            place[p] = place[p - 1]
            p -= 1
        order[p] = value
        place[p] = k
    half = n // 2
    b0 = b1 = b2 = zero
    for s in range(half):
        k = place[s]
        x = int(px + sx * circle[k, 0] + 0.5)
        y = int(py + sy * circle[k, 1] + 0.5)
        b0 += smooth[y, x, 0]
        b1 += smooth[y, x, 1]
        b2 += smooth[y, x, 2]
    b0 /= half
    b1 /= half
    b2 /= half
    # the lower half's mean lies 0.8 sigma below, its span to the median is about 2 sigma of 16 samples
    sigma = max((order[half] - order[0]) / np.float32(1.9), np.float32(0.6))
    # search: the highest place near the prediction
    rx = int(reach * (abs(ax) + abs(bx)) + 0.5)
    ry = int(reach * (abs(ay) + abs(by)) + 0.5)
    cx0, cy0 = int(px + 0.5), int(py + 0.5)
    best = np.float32(-1e9)
    mx, my = px, py
    for y in range(max(1, cy0 - ry), min(h - 1, cy0 + ry + 1)):
        ey = y - py
        for x in range(max(1, cx0 - rx), min(w - 1, cx0 + rx + 1)):
            ex = x - px
            s = (ex * by - ey * bx) / det_ab
            t = (ax * ey - ay * ex) / det_ab
            r2 = s * s + t * t
            if r2 > reach * reach and not (x == cx0 and y == cy0):
                continue
            value = w0 * smooth[y, x, 0] + w1 * smooth[y, x, 1] + w2 * smooth[y, x, 2] - order[half // 2]
            value *= one - np.float32(0.5) * r2 / (reach * reach)
            if value > best:
                best = value
                mx, my = np.float32(x), np.float32(y)
    offset = w0 * b0 + w1 * b1 + w2 * b2
    det = max(cxx * cyy - cxy * cxy, np.float32(1e-3))
    scale = one / (det * np.float32(WEIGHT * WEIGHT))
    ixx = cyy * scale
    ixy = -2 * cxy * scale
    iyy = cxx * scale
    hx = np.float32(WEIGHT) * np.sqrt(cxx)
    hy = np.float32(WEIGHT) * np.sqrt(cyy)
    total = zero
    for _ in range(4):
        x0, x1 = max(0, int(mx - hx + one)), min(w - 1, int(mx + hx))
        y0, y1 = max(0, int(my - hy + one)), min(h - 1, int(my + hy))
        tx = ty = total = zero
        for y in range(y0, y1 + 1):
            dy = y - my
            for x in range(x0, x1 + 1):
                dx = x - mx
                g = max(one - (ixx * dx * dx + ixy * dx * dy + iyy * dy * dy), zero)
                g = g * g * (w0 * smooth[y, x, 0] + w1 * smooth[y, x, 1] + w2 * smooth[y, x, 2] - offset)
                total += g
                tx += g * dx
                ty += g * dy
        if total <= 0:
            return False
        tx = np.float32(1.5) * tx / total
        ty = np.float32(1.5) * ty / total
        mx += tx
        my += ty
        if tx * tx + ty * ty < 1e-4:
            break
    ex, ey = mx - px, my - py
    s = (ex * by - ey * bx) / det_ab
    t = (ax * ey - ay * ex) / det_ab
    if s * s + t * t > reach * reach:
        return False
    # colour: mean over the core (the ellipse of two standard deviations, which a disc fills)
    hx = np.float32(2.0) * np.sqrt(cxx)
    hy = np.float32(2.0) * np.sqrt(cyy)
    ixx = cyy / det * np.float32(0.25)
    ixy = -2 * cxy / det * np.float32(0.25)
    iyy = cxx / det * np.float32(0.25)
    c0 = c1 = c2 = zero
    m = 0
    saturated = 0
    x0, x1 = max(0, int(mx - hx + one)), min(w - 1, int(mx + hx))
    y0, y1 = max(0, int(my - hy + one)), min(h - 1, int(my + hy))
    for y in range(y0, y1 + 1):
        dy = y - my
        for x in range(x0, x1 + 1):
            dx = x - mx
            if ixx * dx * dx + ixy * dx * dy + iyy * dy * dy > one:
                continue
            p0, p1, p2 = smooth[y, x, 0], smooth[y, x, 1], smooth[y, x, 2]
            c0 += p0
            c1 += p1
            c2 += p2
            m += 1
            if p0 >= 250 or p1 >= 250 or p2 >= 250:
                saturated += 1
    if m == 0:
        return False
    out[0] = mx
    out[1] = my
    out[2] = c0 / m - b0
    out[3] = c1 / m - b1
    out[4] = c2 / m - b2
    spread = sigma * np.sqrt(one / half + one / max(one, m / np.float32(3)))
    out[5] = spread
    out[6] = saturated / m
    return w0 * out[2] + w1 * out[3] + w2 * out[4] > np.float32(LEAST_CONTRAST) * spread
