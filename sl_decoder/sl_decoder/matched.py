"""Measurement of a dot where one is expected: around a predicted place, with a known shape and letter colour.

Knowing where to look, what shape and which mixture of channels to expect lets a dot be found that is too faint to stand
out of the noise by itself, that merged with its neighbour, or that merely moved since the last image.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.backgrounds import SAMPLES
from sl_decoder.compiled import compiled
from sl_decoder.planes import SATURATED

WEIGHT = 2.6  # the weight is zero at this many times the size of the core
LANES = 64  # pixels of a window that are summed at once
LEAST_CONTRAST = 2.5  # standard deviations that a dot's mean must stand above its background
STEPS = 8  # at most, towards the centroid: what does not come to rest is no dot's middle
SETTLED = 0.1  # a step [px] after which the centroid has been reached: the next would be a tenth of it
SLOPE = 0.3  # of the centroid against the middle of the weight, at least; that of a disc is a quarter to a half
MERGED_SLOPE = 0.67  # for dots that were searched: with long steps, what merged with a neighbour would slide into it
MARGIN = 0.8  # px from the middle of a window, beyond which the next step is made in another one

LARGEST = 128  # side of a window [px]
_HEAD = 4 * SAMPLES  # in the memory to work with: behind the samples, columns and rows of the window that follows
_WINDOW = _HEAD + 16
FOUND = 10
"""Numbers that `measure_at` finds."""


@compiled
def workspace():
    """Memory that `measure_at` needs to work with."""
    work = np.empty(_WINDOW + 5 * LARGEST * LARGEST, np.float32)
    work[_HEAD] = work[_HEAD + 1] = np.float32(0)
    return work


@compiled
def _surroundings(smooth, px, py, sx, sy, mix, circle, work):
    """Background around a dot at (px, py): mean of the darker half of the samples on the ellipse (sx, sy).

    Neighbouring dots may cover the others. work (4 S,) float32. Returns its three channels, its noise and the level of
    its darker quarter under the mixture `mix`.
    """
    s = SAMPLES
    one, zero = np.float32(1), np.float32(0)
    for k in range(s):
        x = int(px + sx * circle[k, 0] + np.float32(0.5))
        y = int(py + sy * circle[k, 1] + np.float32(0.5))
        work[k] = np.float32(smooth[0, y, x])
        work[s + k] = np.float32(smooth[1, y, x])
        work[2 * s + k] = np.float32(smooth[2, y, x])
    for k in range(s):
        value = mix[0] * work[k] + mix[1] * work[s + k] + mix[2] * work[2 * s + k]
        work[3 * s + k] = value + np.float32(k) * np.float32(1e-3)  # distinct: of equal ones the first is the darker
    half = s >> 1
    b0 = b1 = b2 = lowest = quarter = middle = zero
    for k in range(s):
        value = work[3 * s + k]
        rank = zero
        for j in range(s):
            rank += one if work[3 * s + j] < value else zero
        use = one if rank < half else zero
        b0 += use * work[k]
        b1 += use * work[s + k]
        b2 += use * work[2 * s + k]
        lowest += value if rank == 0 else zero
        quarter += value if rank == half >> 1 else zero
        middle += value if rank == half else zero
    # the lower half's mean lies 0.8 sigma below, its span to the median is about 2 sigma of 16 samples
    sigma = max((middle - lowest) / np.float32(1.9), np.float32(0.6))
    share = one / np.float32(half)
    return b0 * share, b1 * share, b2 * share, sigma, quarter


@compiled
def _cut_out(smooth, px, py, hx, hy, work):
    """Cut out of an image what lies within (hx, hy) of (px, py).

    The window in `work` gets lists of its pixels' x, y, B, G, R, one after the other: single precision only, which
    makes wide vectors. Returns left, top and the number of pixels; 0 where it does not fit.
    """
    _, h, w = smooth.shape
    cols = 8
    while cols < np.float32(2) * hx + np.float32(1):
        cols *= 2
    step = max(1, LANES // cols)
    rows = (int(np.float32(2) * hy) + step + 1) // step * step
    left = max(0, min(int(px - np.float32(0.5) * np.float32(cols - 2)), w - cols))
    top = max(0, min(int(py - np.float32(0.5) * np.float32(rows - 2)), h - rows))
    size = rows * cols
    window = work[_WINDOW:]
    if 5 * size > len(window) or cols > w or rows > h:
        return left, top, 0
    if work[_HEAD] != cols or work[_HEAD + 1] != rows:  # seldom: most dots of an image are of a size
        work[_HEAD], work[_HEAD + 1] = cols, rows
        for k in range(size):
            window[k], window[size + k] = k % cols, k // cols
    for c in range(3):
        for y in range(rows):
            # slices: the compiler then sees how they lie, and makes vectors of this
            row = smooth[c, top + y, left : left + cols]
            first = (2 + c) * size + y * cols
            to = window[first : first + cols]
            for x in range(cols):
                to[x] = np.float32(row[x])
    return left, top, size


@compiled
def _weigh(window, size, mx, my, ixx, ixy, iyy, mix, offset, slope, out):
    """What stands above `offset` in a window of `size` pixels, under the weight of an ellipse around (mx, my).

    out (9,) gets Newton's step from there to the point that is the centroid under the weight around it; mean B, G, R,
    share of saturated pixels, and covariance xx, xy, yy. slope: see SLOPE. Returns False where there is no such point.
    """
    one, zero = np.float32(1), np.float32(0)
    w0, w1, w2 = mix[0], mix[1], mix[2]
    c0 = c1 = c2 = weight = saturated = tx = ty = total = lost = xx = xy = yy = zero
    for k in range(size):
        dx, dy = window[k] - mx, window[k + size] - my
        p0, p1, p2 = window[k + 2 * size], window[k + 3 * size], window[k + 4 * size]
        q = max(one - (ixx * dx * dx + ixy * dx * dy + iyy * dy * dy), zero)
        g = q * q
        weight += g
        c0 += g * p0
        c1 += g * p1
        c2 += g * p2
        saturated += g if max(max(p0, p1), p2) >= np.float32(SATURATED) else zero
        height = w0 * p0 + w1 * p1 + w2 * p2 - offset
        lost += (q - g) * height
        g *= height
        total += g
        tx += g * dx
        ty += g * dy
        xx += g * dx * dx
        xy += g * dx * dy
        yy += g * dy * dy
    # how the weighted sums of dx and dy fall along the way, the mean of the two axes
    fall = max(total - np.float32(2) * lost, slope * total)
    if fall <= zero:
        return False
    out[0], out[1] = tx / fall, ty / fall
    share = one / weight
    out[2], out[3], out[4], out[5] = c0 * share, c1 * share, c2 * share, saturated * share
    share = one / total
    out[6], out[7], out[8] = xx * share, xy * share, yy * share
    return True


@compiled
def _settle(smooth, px, py, cxx, cxy, cyy, mix, offset, slope, work, out):
    """Follow the centroid from (px, py) to its fixed point: out (9,) gets its place, and what `_weigh` gives there.

    Returns False where there is none within STEPS, or the image ends.
    """
    one = np.float32(1)
    hx, hy = np.float32(WEIGHT) * np.sqrt(cxx), np.float32(WEIGHT) * np.sqrt(cyy)
    norm = one / (max(cxx * cyy - cxy * cxy, np.float32(1e-3)) * np.float32(WEIGHT * WEIGHT))
    ixx, ixy, iyy = cyy * norm, np.float32(-2) * cxy * norm, cxx * norm
    right, bottom = smooth.shape[2] - hx, smooth.shape[1] - hy
    x, y = px, py
    left = top = size = 0
    window = work[_WINDOW:]
    x0 = y0 = np.float32(-1e9)  # middle of the window
    for _ in range(STEPS):
        if abs(x - x0) + abs(y - y0) > np.float32(MARGIN):
            if not (hx <= x < right and hy <= y < bottom):
                return False
            left, top, size = _cut_out(smooth, x, y, hx, hy, work)
            if size == 0:
                return False
            x0, y0 = x, y
        mx, my = x - np.float32(left), y - np.float32(top)
        if not _weigh(window, size, mx, my, ixx, ixy, iyy, mix, offset, slope, out):
            return False
        tx, ty = out[0], out[1]
        x += tx
        y += ty
        if tx * tx + ty * ty < np.float32(SETTLED * SETTLED):
            out[0], out[1] = x, y
            return True
    return False


@compiled
def _search(smooth, px, py, mix, ax, ay, bx, by, reach, dark):
    """The highest place within `reach` of (px, py) in the lattice a, b [px]; what is further away counts less."""
    h, w = smooth.shape[1], smooth.shape[2]
    one = np.float32(1)
    rx = int(reach * (abs(ax) + abs(bx)) + np.float32(0.5))
    ry = int(reach * (abs(ay) + abs(by)) + np.float32(0.5))
    cx, cy = int(px + np.float32(0.5)), int(py + np.float32(0.5))
    best = np.float32(-1e9)
    mx, my = px, py
    scale = one / ((ax * by - ay * bx) * reach)
    for y in range(max(1, cy - ry), min(h - 1, cy + ry + 1)):
        ey = (np.float32(y) - py) * scale
        for x in range(max(1, cx - rx), min(w - 1, cx + rx + 1)):
            ex = (np.float32(x) - px) * scale
            s = ex * by - ey * bx
            t = ax * ey - ay * ex
            r2 = s * s + t * t
            value = mix[0] * smooth[0, y, x] + mix[1] * smooth[1, y, x] + mix[2] * smooth[2, y, x]
            value = (value - dark) * (one - np.float32(0.5) * r2)
            if value > best and (r2 <= one or (x == cx and y == cy)):
                best = value
                mx, my = np.float32(x), np.float32(y)
    return mx, my


@compiled
def measure_at(smooth, px, py, cxx, cxy, cyy, mix, ax, ay, bx, by, reach, least, circle, work, out):
    """Find and measure the dot near (px, py).

    smooth (3, H, W) uint8; cxx, cxy, cyy expected core covariance [px^2]; mix (3,) expected share of the channels; a, b
    local lattice basis [px], in which `reach` bounds the search; circle (S, 2); work: see `workspace`. The dot under
    the prediction is taken if its mean signal is at least `least`, else the highest place around is searched.
    out (FOUND,) float32 gets x, y, B, G, R above the background, the share of saturated pixels, the covariance xx, xy,
    yy under the weight, whose own width bounds it, and the noise of a channel. Returns False where no dot stands out.
    """
    h, w = smooth.shape[1], smooth.shape[2]
    one, zero = np.float32(1), np.float32(0)
    det_ab = ax * by - ay * bx
    if det_ab <= np.float32(1e-3):
        return False
    deviation_x, deviation_y = np.sqrt(cxx), np.sqrt(cyy)
    sx = np.float32(3.2) * deviation_x + np.float32(1.5)
    sy = np.float32(3.2) * deviation_y + np.float32(1.5)
    if not (sx <= px < w - sx - 1 and sy <= py < h - sy - 1):
        return False
    b0, b1, b2, sigma, dark = _surroundings(smooth, px, py, sx, sy, mix, circle, work)
    w0, w1, w2 = mix[0], mix[1], mix[2]
    offset = w0 * b0 + w1 * b1 + w2 * b2
    good = False
    if least < np.inf and _settle(smooth, px, py, cxx, cxy, cyy, mix, offset, np.float32(SLOPE), work, out):
        good = w0 * out[2] + w1 * out[3] + w2 * out[4] - offset >= least
    if not good:
        x, y = _search(smooth, px, py, mix, ax, ay, bx, by, reach, dark)
        if not _settle(smooth, x, y, cxx, cxy, cyy, mix, offset, np.float32(MERGED_SLOPE), work, out):
            return False
    ex, ey = (out[0] - px) / (det_ab * reach), (out[1] - py) / (det_ab * reach)
    s = ex * by - ey * bx
    t = ax * ey - ay * ex
    if s * s + t * t > one:
        return False
    out[2] -= b0
    out[3] -= b1
    out[4] -= b2
    # neighbouring pixels share the filter: about three of the core's count as one
    core = np.float32(4 * np.pi) * np.sqrt(max(cxx * cyy - cxy * cxy, zero))
    noise = sigma * np.sqrt(one / np.float32(SAMPLES >> 1) + one / max(one, core / np.float32(3)))
    out[9] = noise
    return w0 * out[2] + w1 * out[3] + w2 * out[4] > np.float32(LEAST_CONTRAST) * noise
