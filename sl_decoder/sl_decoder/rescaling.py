"""Readings of an image at another size: how it is enlarged, and how its readings become one."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sl_decoder.interpretation import Interpretation
from sl_decoder.state import MEASURED

SHARPENED = 3.0  # width of the blur that is taken off, in pixels of the doubled image: about that of a dot
SMOOTHING = 0.5  # px^2 that the mosaic's filter adds to a footprint
LEAST_VARIANCE = 1 / 12  # px^2 of a footprint: that of one pixel
APART = 1.0  # squared distance from all others that a dot of the other reading keeps, in areas of its core


def doubled_and_sharpened(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """An image (H, W, 3) at twice its size, with what a dot's blur takes put back (unsharp masking)."""
    doubled = cv2.resize(bgr, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    return cv2.addWeighted(doubled, 2.0, cv2.GaussianBlur(doubled, (0, 0), SHARPENED), -1.0, 0.0)


def enlarge(reading: Interpretation, scale: float) -> None:
    """Bring what was measured in an image of another size to pixels of one `scale` times as large, the camera's."""
    used = slice(reading.n)
    reading.centre[used] = scale * reading.centre[used] + np.float32(0.5 * scale - 0.5)
    covariance = reading.covariance[used]
    covariance *= np.float32(scale * scale)
    smoothing = np.float32(SMOOTHING * (1.0 - scale * scale))
    covariance[:, ::2] = np.maximum(covariance[:, ::2] + smoothing, np.float32(LEAST_VARIANCE))
    reading.area[used] = np.rint(scale * scale * reading.area[used])
    reading.pixel = np.float32(1)


def adopt(reading: Interpretation, other: Interpretation, limit: float) -> None:
    """Take over the dots that another reading of the image has in addition, and judge them beside those that are there.

    Like what was looked for where it was expected, they count as recovered: more is asked of them.
    """
    v, u = np.nonzero((reading.claim < 0) & (other.claim >= 0))
    held = reading.claim[reading.claim >= 0]
    if not len(v) or not len(held):
        return
    dots = other.claim[v, u]
    nearest, _ = cv2.batchDistance(other.centre[dots], reading.centre[held], cv2.CV_32F, normType=cv2.NORM_L2SQR, K=1)
    apart = nearest[:, 0] > APART * other.area[dots]
    v, u, dots = v[apart], u[apart], dots[apart]
    reading.make_room(len(dots))
    to = np.arange(reading.n, reading.n + len(dots))
    for name in MEASURED:
        getattr(reading, name)[to] = getattr(other, name)[dots]
    reading.n += len(dots)
    reading.claim[v, u] = to
    reading.holder_v[to], reading.holder_u[to] = v, u
    reading.judge(limit)
    reading.finish(limit)
