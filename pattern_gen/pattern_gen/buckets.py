"""Choice of the bucket tables through which near codes are found.

Split the cells of a code (one masked out) into b parts. Two codes that differ in fewer than h cells agree on at least
b - h + 1 parts, so one table for every choice of b - h + 1 parts, keyed by the letters in them, finds every near code.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

MAX_BUCKETS = 2_000_000
MAX_TABLES = 64
_LOOK_UP = 12.0  # cost of visiting a bucket over that of comparing one code


@dataclass(frozen=True, eq=False)
class CellClasses:
    """Cells of a window that rotations bring onto each other (corners, edges, the centre).

    Attributes:
        inverse: (k, n) cell p of a window stands at position inverse[k, p] of its code rotated k times.
        class_of: (n,) class of a cell.
        place_of: (classes,) the position that stands for the class.
        turn_of: (n,) the rotation that brings the cell there.
    """

    inverse: NDArray[np.int64]
    class_of: NDArray[np.int64]
    place_of: NDArray[np.int64]
    turn_of: NDArray[np.int64]


def cell_classes(rotations: NDArray[np.int64], cells: NDArray[np.int64] | None = None) -> CellClasses:
    """Classes of the cells under (k, n) rotations; `cells`: only classes of these cells are wanted."""
    inverse = np.argsort(rotations, axis=1)
    n = rotations.shape[1]
    orbits = [tuple(sorted(set(inverse[:, p].tolist()))) for p in range(n)]
    classes = sorted(set(orbits) if cells is None else {orbits[p] for p in cells})
    place_of = np.array([members[-1] for members in classes], dtype=np.int64)
    class_of = np.array([classes.index(orbit) if orbit in classes else -1 for orbit in orbits], dtype=np.int64)
    turn_of = np.array(
        [int(np.flatnonzero(inverse[:, p] == place_of[class_of[p]])[0]) if class_of[p] >= 0 else 0 for p in range(n)],
        dtype=np.int64,
    )
    return CellClasses(inverse, class_of, place_of, turn_of)


def choose_keys(
    cells: int, alphabet: int, h: int, entries: int, classes: int, *, scan_cost: float
) -> list[tuple[int, ...]]:
    """Cells (0..cells-1) of each table's key, for the least expected work; empty: compare with all codes.

    Args:
        cells: number of cells that are not masked out.
        entries: number of stored codes.
        classes: number of classes that each get such tables.
        scan_cost: cost of a comparison in a scan over one in a bucket.
    """
    best: list[tuple[int, ...]] = []
    best_cost = scan_cost * entries
    for used in range(1, cells + 1):
        for parts in range(h, used + 1):
            split = [part.tolist() for part in np.array_split(np.arange(cells - used, cells), parts)]
            keys = [
                tuple(cell for part in choice for cell in split[part])
                for choice in combinations(range(parts), parts - h + 1)
            ]
            buckets = sum(alphabet ** len(key) for key in keys) * classes
            if len(keys) * classes > MAX_TABLES or buckets > MAX_BUCKETS:
                continue
            cost = sum(_LOOK_UP + entries / alphabet ** len(key) for key in keys)
            if cost < best_cost:
                best, best_cost = keys, cost
    return best


def table_layout(
    keys: list[tuple[int, ...]], places: NDArray[np.int64], cells: int, alphabet: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Weights and first buckets of the tables of every class.

    Returns:
        weights: (classes, tables, cells) int64, key = start + sum of weight * letter; zero at the class's place.
        starts: (classes, tables) int64.
        buckets: total number.
    """
    weights = np.zeros((len(places), len(keys), cells), np.int64)
    starts = np.zeros((len(places), len(keys)), np.int64)
    buckets = 0
    for c, place in enumerate(places):
        others = np.array([cell for cell in range(cells) if cell != place])
        for t, key in enumerate(keys):
            weights[c, t, others[np.array(key, dtype=np.int64)]] = alphabet ** np.arange(len(key))
            starts[c, t] = buckets
            buckets += alphabet ** len(key)
    return weights, starts, buckets
