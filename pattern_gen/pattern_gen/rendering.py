"""Rendering of spots, antialiased so that centroids are exact.

A pixel's value is its drive value times the shape's area weighted by a tent of half width 1 px about the pixel. Tents
reproduce linear functions (sum of n * tent(x - n) = x), so the centroid of a rendered spot is its centre at any
sub-pixel position, up to the rounding to 8 bits. Plain pixel coverage (a box) is off by up to 0.03 px for a square.
A shape is cut into thin horizontal strips about its own centre; the integrals over each strip are exact.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pattern_gen.shapes import SHAPES

STRIPS = 48  # per smooth part of a shape
BATCH_VALUES = 4_000_000  # intermediate values at a time: bounds the memory for large maps


def _overlap(low: NDArray[np.float64], high: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """(..., size): integral over [low, high] of the tent of half width 1 px about each pixel 0..size-1."""

    def integral(x: NDArray[np.float64]) -> NDArray[np.float64]:
        x = np.clip(x[..., None] - np.arange(size), -1.0, 1.0)
        return x - 0.5 * x * np.abs(x)

    return integral(high) - integral(low)


def coverage(shape: str, diameter: float, offsets: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Coverage of size x size pixels by a shape, each pixel weighted by its tent.

    Args:
        shape: a key of SHAPES.
        diameter: in [px].
        offsets: (n, 2) centre (u, v) relative to the centre of the patch's top-left pixel, in [px].
        size: side of the patch in [px].

    Returns:
        (n, size, size) float64 in [0, 1].
    """
    breaks = SHAPES[shape].breaks
    parts = [np.linspace(low, high, STRIPS + 1) for low, high in pairwise(breaks)]
    top = np.concatenate([part[:-1] for part in parts])
    bottom = np.concatenate([part[1:] for part in parts])
    ends = SHAPES[shape].chords(0.5 * (top + bottom)) * diameter  # (strips, k, 2)
    u, v = offsets[:, 0, None], offsets[:, 1, None]
    down = _overlap(top * diameter + v, bottom * diameter + v, size)  # (n, strips, size)
    across = np.sum([_overlap(ends[:, k, 0] + u, ends[:, k, 1] + u, size) for k in range(ends.shape[1])], axis=0)
    return np.matmul(np.swapaxes(down, 1, 2), across)


def render_spots(
    width: int,
    height: int,
    centers: NDArray[np.float64],
    rgb: NDArray[np.float64],
    shapes: NDArray[np.str_],
    diameter: float,
) -> NDArray[np.uint8]:
    """Draw spots on black.

    Args:
        width, height: of the image in [px].
        centers: (n, 2) centres (u, v) in [px].
        rgb: (n, 3) drive values 0..255.
        shapes: (n,) names of shapes.
        diameter: of all spots in [px].

    Returns:
        (height, width, 3) uint8 RGB.
    """
    size = int(np.ceil(diameter)) + 3
    canvas = np.zeros((height + 2 * size, width + 2 * size, 3), dtype=np.float32)
    corner = np.floor(centers - 0.5 * diameter).astype(np.int64)
    fraction = np.round(centers - corner, 9)
    pixel = np.arange(size)
    batch = max(1, BATCH_VALUES // (size * STRIPS * 8))
    for shape in np.unique(shapes):
        chosen = np.flatnonzero(shapes == shape)
        unique, inverse = np.unique(fraction[chosen], axis=0, return_inverse=True)
        inverse = inverse.reshape(-1)
        order = np.argsort(inverse, kind="stable")
        starts = np.searchsorted(inverse[order], np.arange(0, len(unique) + batch, batch))
        for first, begin, end in zip(range(0, len(unique), batch), starts[:-1], starts[1:], strict=False):
            patches = coverage(str(shape), diameter, unique[first : first + batch], size)
            spots = order[begin:end]
            for part in np.array_split(spots, max(1, len(spots) * size * size * 3 // BATCH_VALUES)):
                at = corner[chosen[part]] + size
                values = patches[inverse[part] - first][..., None] * rgb[chosen[part], None, None, :]
                rows = at[:, 1, None, None] + pixel[None, :, None]
                cols = at[:, 0, None, None] + pixel[None, None, :]
                np.add.at(canvas, (rows, cols), values.astype(np.float32))
    image = canvas[size : size + height, size : size + width]
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)
