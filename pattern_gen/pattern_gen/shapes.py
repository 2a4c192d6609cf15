"""Shapes of spots, each described by its chords: the intervals that a horizontal line at height y cuts out of it.

Shapes are given for a diameter of one and the centroid at the origin, so that the centroid of what is rendered is
the spot's centre. Every shape fits into the circle of its diameter: the gap between two spots does not depend on it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Chords = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Heights (n,), down positive -> (n, k, 2): left and right end of k intervals; empty intervals have equal ends."""

RING_INNER = 0.5  # inner over outer diameter
SQUARE_HALF = 0.5 / np.sqrt(2.0)  # half a side: the corners lie on the circle
CROSS_ARM = 0.32  # width of an arm over the diameter
CROSS_REACH = 0.5 * np.sqrt(1.0 - CROSS_ARM**2)  # the arms' corners lie on the circle
EMPTY = 2.0  # both ends of an empty interval


def _interval(y: NDArray[np.float64], half: NDArray[np.float64], inside: NDArray[np.bool_]) -> NDArray[np.float64]:
    return np.where(inside[..., None], np.stack([-half, half], axis=-1), EMPTY)


def _disc(y: NDArray[np.float64]) -> NDArray[np.float64]:
    half = np.sqrt(np.maximum(0.25 - y * y, 0.0))
    return _interval(y, half, np.abs(y) < 0.5)[..., None, :]


def _ring(y: NDArray[np.float64]) -> NDArray[np.float64]:
    outer = np.sqrt(np.maximum(0.25 - y * y, 0.0))
    inner = np.sqrt(np.maximum((0.5 * RING_INNER) ** 2 - y * y, 0.0))
    inside = (np.abs(y) < 0.5)[..., None]
    left, right = np.stack([-outer, -inner], axis=-1), np.stack([inner, outer], axis=-1)
    return np.stack([np.where(inside, left, EMPTY), np.where(inside, right, EMPTY)], axis=-2)


def _square(y: NDArray[np.float64]) -> NDArray[np.float64]:
    return _interval(y, np.full_like(y, SQUARE_HALF), np.abs(y) < SQUARE_HALF)[..., None, :]


def _cross(y: NDArray[np.float64]) -> NDArray[np.float64]:
    half = np.where(np.abs(y) < 0.5 * CROSS_ARM, CROSS_REACH, 0.5 * CROSS_ARM)
    return _interval(y, half, np.abs(y) < CROSS_REACH)[..., None, :]


def _triangle(y: NDArray[np.float64]) -> NDArray[np.float64]:
    half = (y + 0.5) / np.sqrt(3.0)  # tip up (towards -v), base at y = 0.25: centroid at the origin
    return _interval(y, half, (y > -0.5) & (y < 0.25))[..., None, :]


@dataclass(frozen=True)
class Shape:
    """A shape of diameter one: its chords, and the heights between which they change smoothly."""

    chords: Chords
    breaks: tuple[float, ...]


SHAPES: dict[str, Shape] = {
    "disc": Shape(_disc, (-0.5, 0.5)),
    "ring": Shape(_ring, (-0.5, -0.5 * RING_INNER, 0.5 * RING_INNER, 0.5)),
    "square": Shape(_square, (-SQUARE_HALF, SQUARE_HALF)),
    "cross": Shape(_cross, (-CROSS_REACH, -0.5 * CROSS_ARM, 0.5 * CROSS_ARM, CROSS_REACH)),
    "triangle": Shape(_triangle, (-0.5, 0.25)),
}
