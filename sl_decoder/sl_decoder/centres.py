"""Sub-pixel centres, colours and shapes of blobs, from windows of the image around them.

Every window subtracts its own background (the pixels around that belong to no blob) and ignores the pixels of other blobs.
The centre is the centroid under an elliptic weight that has the blob's own shape and falls smoothly to zero, iterated to
its fixed point; a hard threshold would pull it towards the pixel grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from sl_decoder.segmentation import Segments

SUPPORT = 3.0  # the weight is zero at this many times the size of the core
SATURATED = 250  # a channel from here on has lost its proportion


@dataclass(frozen=True)
class Dots:
    """Measured dots, N entries each.

    centre (N, 2) float32 px; colour (N, 3) float32 B, G, R above the background, mean over the core, counts;
    covariance (N, 3) float32 xx, xy, yy, px^2; noise (N,) float32 standard deviation of a channel's mean, counts;
    saturated (N,) float32 share of core pixels with a saturated channel.
    """

    centre: np.ndarray
    colour: np.ndarray
    covariance: np.ndarray
    noise: np.ndarray
    saturated: np.ndarray

    def __len__(self) -> int:
        return len(self.noise)


@njit(cache=True, boundscheck=False, fastmath=True)
def _measure(smooth, hat, label, start, cov, peak, floor, area, max_radius,  # type: ignore[no-untyped-def]
             centre, colour, noise, saturated):
    h, w = hat.shape
    for j in range(len(peak)):
        cx, cy = start[j, 0], start[j, 1]
        cxx, cxy, cyy = cov[j, 0], cov[j, 1], cov[j, 2]
        det = cxx * cyy - cxy * cxy
        if det < 1e-3:
            det = 1e-3
        ixx, ixy, iyy = cyy / det, -cxy / det, cxx / det
        rx = min(max_radius, int(SUPPORT * np.sqrt(cxx) * 1.2 + 1.5))
        ry = min(max_radius, int(SUPPORT * np.sqrt(cyy) * 1.2 + 1.5))
        x0 = max(0, int(cx + 0.5) - rx)
        x1 = min(w, int(cx + 0.5) + rx + 1)
        y0 = max(0, int(cy + 0.5) - ry)
        y1 = min(h, int(cy + 0.5) + ry + 1)
        me = j + 1
        half = floor[j] + 0.5 * (peak[j] - floor[j])
        nb = 0
        b0 = b1 = b2 = 0.0
        nc = 0
        c0 = c1 = c2 = 0.0
        s2 = 0.0
        ns = 0
        for y in range(y0, y1):
            for x in range(x0, x1):
                lab = label[y, x]
                p0, p1, p2 = float(smooth[y, x, 0]), float(smooth[y, x, 1]), float(smooth[y, x, 2])
                if lab == 0:
                    nb += 1
                    b0 += p0
                    b1 += p1
                    b2 += p2
                    s2 += p0 * p0 + p1 * p1 + p2 * p2
                elif lab == me and hat[y, x] >= half:
                    nc += 1
                    c0 += p0
                    c1 += p1
                    c2 += p2
                    if p0 >= SATURATED or p1 >= SATURATED or p2 >= SATURATED:
                        ns += 1
        if nb < 4 or nc == 0:
            centre[j, 0] = cx
            centre[j, 1] = cy
            noise[j] = 0.0
            for c in range(3):
                colour[j, c] = 0.0
            saturated[j] = 0.0
            continue
        b0 /= nb
        b1 /= nb
        b2 /= nb
        colour[j, 0] = c0 / nc - b0
        colour[j, 1] = c1 / nc - b1
        colour[j, 2] = c2 / nc - b2
        noise[j] = np.sqrt(max(s2 / nb - b0 * b0 - b1 * b1 - b2 * b2, 0.1) / 3.0)
        saturated[j] = ns / nc
        # weights of the channels: as they contribute to this dot
        w0, w1, w2 = max(colour[j, 0], 0.0), max(colour[j, 1], 0.0), max(colour[j, 2], 0.0)
        total = w0 + w1 + w2
        if total > 0:
            w0 /= total
            w1 /= total
            w2 /= total
        offset = w0 * b0 + w1 * b1 + w2 * b2
        k = 1.0 / (SUPPORT * SUPPORT)
        for _ in range(3):
            sx = sy = sw = 0.0
            for y in range(y0, y1):
                dy = y - cy
                for x in range(x0, x1):
                    lab = label[y, x]
                    if lab != 0 and lab != me:
                        continue
                    dx = x - cx
                    q = 1.0 - k * (ixx * dx * dx + 2.0 * ixy * dx * dy + iyy * dy * dy)
                    if q <= 0.0:
                        continue
                    v = w0 * smooth[y, x, 0] + w1 * smooth[y, x, 1] + w2 * smooth[y, x, 2] - offset
                    v *= q * q
                    sw += v
                    sx += v * dx
                    sy += v * dy
            if sw <= 0.0:
                break
            # the centroid under a weight of the blob's own width moves by about half of the offset
            mx = 1.6 * sx / sw
            my = 1.6 * sy / sw
            cx += mx
            cy += my
            if mx * mx + my * my < 1e-5:
                break
        if (cx - start[j, 0]) ** 2 + (cy - start[j, 1]) ** 2 > 0.5 * (cxx + cyy) + 0.25:
            cx, cy = start[j, 0], start[j, 1]
        centre[j, 0] = cx
        centre[j, 1] = cy


def measure(segments: Segments, *, max_radius: int = 40) -> Dots:
    """Measure all blobs of a segmented image; `max_radius` bounds the windows [px]."""
    blobs = segments.blobs
    n = len(blobs)
    centre = np.empty((n, 2), np.float32)
    colour = np.empty((n, 3), np.float32)
    noise = np.empty(n, np.float32)
    saturated = np.empty(n, np.float32)
    _measure(segments.smooth, segments.hat, segments.label, blobs.centre, blobs.covariance, blobs.peak, blobs.floor,
             blobs.area, max_radius, centre, colour, noise, saturated)
    return Dots(centre, colour, blobs.covariance, noise, saturated)
