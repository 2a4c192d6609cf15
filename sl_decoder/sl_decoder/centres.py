"""Sub-pixel centres, colours and shapes of blobs.

A blob's own pixels alone are used, above a background sampled around it where no blob lies. The centre is the centroid
under an elliptic weight of the blob's own shape that falls smoothly to zero, iterated to its fixed point; a hard
threshold would pull it towards the pixel grid.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sl_decoder.compiled import compiled
from sl_decoder.segmentation import Segments

SUPPORT = 3.0  # the weight is zero at this many times the size of the core
SATURATED = 250  # a channel from here on has lost its proportion


@dataclass(frozen=True)
class Dots:
    """Measured dots, N entries each.

    centre (N, 2) float32 px; colour (N, 3) float32 B, G, R above the background, mean over the core, counts;
    covariance (N, 3) float32 xx, xy, yy of the core, px^2; area (N,) int32 pixels of the core (above half of the peak);
    noise (N,) float32 uncertainty of a colour channel, counts; saturated (N,) float32 share of saturated core pixels;
    cut (N,) bool: touches the border of the image; profile (N,) float32: logarithm of the affine-invariant radial
    kurtosis, which tells shapes apart (ring < disc < square < cross, triangle).
    """

    centre: NDArray[np.float32]
    colour: NDArray[np.float32]
    covariance: NDArray[np.float32]
    area: NDArray[np.int32]
    noise: NDArray[np.float32]
    saturated: NDArray[np.float32]
    cut: NDArray[np.bool_]
    profile: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.noise)


@compiled
def _measure(
    signal,
    smooth,
    hat,
    label,
    xs,
    ys,
    start,
    peak,
    floor,
    circle,
    centre,
    colour,
    covariance,
    area,
    noise,
    saturated,
    cut,
    profile,
):
    h, w = hat.shape
    values = hat.ravel()
    channels = signal.reshape(-1)
    bright = smooth.reshape(-1)
    largest = 0
    for j in range(len(peak)):
        largest = max(largest, start[j + 1] - start[j])
    vx = np.empty(largest, np.float32)
    vy = np.empty(largest, np.float32)
    vv = np.empty(largest, np.float32)
    ring_value = np.empty(len(circle), np.uint8)
    ring_place = np.empty(len(circle), np.int64)
    one = np.float32(1.0)
    for j in range(len(peak)):
        s, e = start[j], start[j + 1]
        half = floor[j] + np.float32(0.5) * (peak[j] - floor[j])
        n = 0
        sat = 0
        sx = sy = sw = np.float32(0)
        c0 = c1 = c2 = np.float32(0)
        x_first, y_first = xs[s], ys[s]
        xx = xy = yy = np.float32(0)
        mx = my = np.float32(0)
        touches = False
        for k in range(s, e):
            x, y = np.int64(xs[k]), np.int64(ys[k])
            i = y * w + x
            v = np.float32(values[i])
            if v < half:
                continue
            dx = np.float32(x - x_first)
            dy = np.float32(y - y_first)
            n += 1
            v -= floor[j]
            sw += v
            sx += v * dx
            sy += v * dy
            mx += dx
            my += dy
            xx += dx * dx
            xy += dx * dy
            yy += dy * dy
            c0 += channels[3 * i]
            c1 += channels[3 * i + 1]
            c2 += channels[3 * i + 2]
            if bright[3 * i] >= SATURATED or bright[3 * i + 1] >= SATURATED or bright[3 * i + 2] >= SATURATED:
                sat += 1
            if x <= 1 or y <= 1 or x >= w - 2 or y >= h - 2:
                touches = True
        r = one / n
        mx *= r
        my *= r
        # a pixel is a square: its own variance adds
        xx = xx * r - mx * mx + np.float32(1 / 12)
        xy = xy * r - mx * my
        yy = yy * r - my * my + np.float32(1 / 12)
        cx = x_first + sx / sw
        cy = y_first + sy / sw
        covariance[j, 0] = xx
        covariance[j, 1] = xy
        covariance[j, 2] = yy
        area[j] = n
        saturated[j] = sat * r
        cut[j] = touches
        # the background: where no blob lies, on an ellipse around
        rx = np.float32(3.2) * np.sqrt(xx) + np.float32(1.5)
        ry = np.float32(3.2) * np.sqrt(yy) + np.float32(1.5)
        m = 0
        for k in range(len(circle)):
            x = int(cx + rx * circle[k, 0] + 0.5)
            y = int(cy + ry * circle[k, 1] + 0.5)
            if x < 0 or y < 0 or x >= w or y >= h or label[y, x] != 0:
                continue
            i = y * w + x
            value = values[i]
            p = m
            while p > 0 and ring_value[p - 1] > value:
                ring_value[p] = ring_value[p - 1]
                ring_place[p] = ring_place[p - 1]
                p -= 1
            ring_value[p] = value
            ring_place[p] = 3 * i
            m += 1
        b0 = b1 = b2 = np.float32(0)
        if m >= 3:
            # the lower three quarters: skirts of neighbours brighten the rest
            m -= m // 4
            q = np.float32(0)
            for k in range(m):
                i = ring_place[k]
                p0, p1, p2 = np.float32(channels[i]), np.float32(channels[i + 1]), np.float32(channels[i + 2])
                b0 += p0
                b1 += p1
                b2 += p2
                q += p0 * p0 + p1 * p1 + p2 * p2
            b0 /= m
            b1 /= m
            b2 /= m
            spread = np.sqrt(max((q / m - b0 * b0 - b1 * b1 - b2 * b2) / 3.0, 0.3))
            # neighbouring pixels share the filter: about three of them count as one
            noise[j] = spread * np.sqrt(one / m + one / max(one, n / np.float32(3)))
        else:
            b0 = b1 = b2 = floor[j]
            noise[j] = max(floor[j], one)
        c0 = c0 * r - b0
        c1 = c1 * r - b1
        c2 = c2 * r - b2
        colour[j, 0] = c0
        colour[j, 1] = c1
        colour[j, 2] = c2
        # the dot's own mixture of channels has the least noise
        w0 = max(c0, np.float32(0))
        w1 = max(c1, np.float32(0))
        w2 = max(c2, np.float32(0))
        total = w0 + w1 + w2
        profile[j] = np.float32(0)
        if total <= 0:
            centre[j, 0] = cx
            centre[j, 1] = cy
            continue
        w0 /= total
        w1 /= total
        w2 /= total
        offset = w0 * b0 + w1 * b1 + w2 * b2
        count = e - s
        for k in range(count):
            i = np.int64(ys[s + k]) * w + xs[s + k]
            vx[k] = np.float32(xs[s + k]) - cx
            vy[k] = np.float32(ys[s + k]) - cy
            vv[k] = w0 * channels[3 * i] + w1 * channels[3 * i + 1] + w2 * channels[3 * i + 2] - offset
        det = max(xx * yy - xy * xy, np.float32(1e-3)) * np.float32(SUPPORT * SUPPORT)
        ixx = yy / det
        ixy = -2 * xy / det
        iyy = xx / det
        ox = oy = np.float32(0)
        for _ in range(4):
            sx = sy = sw = np.float32(0)
            for k in range(count):
                dx = vx[k] - ox
                dy = vy[k] - oy
                g = max(one - (ixx * dx * dx + ixy * dx * dy + iyy * dy * dy), np.float32(0))
                g = g * g * vv[k]
                sw += g
                sx += g * dx
                sy += g * dy
            if sw <= 0:
                break
            # under a weight of the blob's own width the centroid moves by about 0.6 of the offset
            sx = np.float32(1.6) * sx / sw
            sy = np.float32(1.6) * sy / sw
            ox += sx
            oy += sy
            if sx * sx + sy * sy < 2e-5:
                break
        if ox * ox + oy * oy > 0.5 * (xx + yy) + 0.25:
            ox = oy = np.float32(0)
        centre[j, 0] = cx + ox
        centre[j, 1] = cy + oy
        sw = m2 = m4 = np.float32(0)
        for k in range(count):
            dx = vx[k] - ox
            dy = vy[k] - oy
            v = max(vv[k], np.float32(0))
            r2 = ixx * dx * dx + ixy * dx * dy + iyy * dy * dy
            sw += v
            m2 += v * r2
            m4 += v * r2 * r2
        if m2 > 0:
            profile[j] = np.log(m4 * sw / (m2 * m2))


_ANGLE = np.arange(16) * (2 * np.pi / 16)
_CIRCLE = np.stack([np.cos(_ANGLE), np.sin(_ANGLE)], 1).astype(np.float32)


def measure(segments: Segments) -> Dots:
    """Measure all blobs of a segmented image."""
    n = len(segments)
    dots = Dots(
        centre=np.empty((n, 2), np.float32),
        colour=np.empty((n, 3), np.float32),
        covariance=np.empty((n, 3), np.float32),
        area=np.empty(n, np.int32),
        noise=np.empty(n, np.float32),
        saturated=np.empty(n, np.float32),
        cut=np.empty(n, np.bool_),
        profile=np.zeros(n, np.float32),
    )
    _measure(
        segments.signal,
        segments.smooth,
        segments.hat,
        segments.label,
        segments.xs,
        segments.ys,
        segments.start,
        segments.peak,
        segments.floor,
        _CIRCLE,
        dots.centre,
        dots.colour,
        dots.covariance,
        dots.area,
        dots.noise,
        dots.saturated,
        dots.cut,
        dots.profile,
    )
    return dots
