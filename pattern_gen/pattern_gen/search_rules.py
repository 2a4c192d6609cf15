"""What the depth-first search must observe: rules, counters, and the choice of a letter."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pattern_gen.packing import popcount, random_below, random_unit
from pattern_gen.windows import WindowGeometry

DEPTH, DEEPEST, SINCE, STEPS, ENTERING, FLOOR = 0, 1, 2, 3, 4, 5  # indices into a state's counters


class Rules(NamedTuple):
    """What a map must satisfy, and how the search goes about it."""

    cols: int
    alphabet: int
    h: int
    own: int  # least distance of a window from its own rotations, 0: any
    band: int  # windows more than this many rows apart may be equal; -1: none may
    patience: int  # steps without progress before a back-jump; 0: never
    deviation: float  # probability of a random letter instead of the lowest: 0 ascending order, 1 random order


def fresh_counters() -> NDArray[np.int64]:
    """(6,) int64: the counters of a search that enters its first cell."""
    counters = np.zeros(6, np.int64)
    counters[ENTERING] = 1
    return counters


@njit(cache=True)
def pick(free: np.uint64, random: NDArray[np.uint64], deviation: float) -> int:
    """A letter out of the free ones: the lowest, or with probability `deviation` a random one."""
    if deviation > 0.0 and (deviation >= 1.0 or random_unit(random) < deviation):
        for _ in range(random_below(random, popcount(free))):
            free &= free - np.uint64(1)
    return popcount((free & (~free + np.uint64(1))) - np.uint64(1))


def cell_steps(geometry: WindowGeometry, turns: int, cols: int) -> NDArray[np.int64]:
    """(2, turns, n) int64: from a window's centre to the cells of its rotated codes in a flat map of so many columns,
    for centres in even and odd columns."""
    flat = geometry.offsets[..., 0] * cols + geometry.offsets[..., 1]
    return np.ascontiguousarray(flat[:, geometry.rotations[:turns]])
