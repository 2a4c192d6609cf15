"""The order in which a depth-first search fills the cells, and the windows that each cell completes."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pattern_gen.pattern import Grid
from pattern_gen.windows import WindowGeometry

HEXAGONAL_ASPECT = 8.0 / (
    3.0 * np.sqrt(3.0)
)  # columns per row of a 4:3 image: columns are closer together, section II.D
_CHUNK = 100_000


class FillOrder(NamedTuple):
    """Steps of a search. Step i fills cell cells[i] and completes windows[first[i]:first[i + 1]].

    `places` says at which position of each of these windows the cell stands. Windows are numbered row-major by centre.
    `whole[i]` is 1 where the cells filled after step i are a map worth keeping.
    """

    cells: NDArray[np.int32]
    first: NDArray[np.int32]
    windows: NDArray[np.int32]
    places: NDArray[np.int32]
    whole: NDArray[np.uint8]


def raster_order(geometry: WindowGeometry, rows: int, cols: int) -> FillOrder:
    """Row by row (square), column by column (hexagonal): each cell completes at most one window, as its last cell."""
    margin, width = geometry.margin, cols - 2 * geometry.margin
    cells = np.arange(rows * cols, dtype=np.int32)
    if geometry.grid is Grid.HEXAGONAL:
        cells = np.ascontiguousarray(cells.reshape(rows, cols).T).reshape(-1)
    row, col = cells // cols, cells % cols
    last = geometry.offsets[:, -1]
    centre_col = col - last[0, 1]
    centre_row = row - last[centre_col % 2, 0]
    inside = (
        (centre_row >= margin) & (centre_row < rows - margin) & (centre_col >= margin) & (centre_col < cols - margin)
    )
    first = np.concatenate([[0], np.cumsum(inside)]).astype(np.int32)
    windows = ((centre_row - margin) * width + centre_col - margin)[inside].astype(np.int32)
    whole = np.zeros(rows * cols, np.uint8)
    line = cols if geometry.grid is Grid.SQUARE else rows
    whole[geometry.window * line - 1 :: line] = 1
    return FillOrder(cells, first, windows, np.full(len(windows), geometry.size - 1, np.int32), whole)


def growth_sizes(window: int, aspect: float, limit: int, start: tuple[int, int] | None = None) -> list[tuple[int, int]]:
    """Sizes (rows, cols) of a map that grows from window x window, or `start`, by one column or one row at a time.

    Section II.B: a column is added while the map stays within the aspect ratio (columns over rows), else a row.

    Args:
        limit: the last size has at least this many cells.
    """
    rows, cols = start or (window, window)
    sizes = [(rows, cols)]
    while rows * cols < limit:
        if cols + 1 <= aspect * rows + 1e-9:
            cols += 1
        else:
            rows += 1
        sizes.append((rows, cols))
    return sizes


def growth_to(window: int, rows: int, cols: int, start: tuple[int, int] | None = None) -> list[tuple[int, int]]:
    """Sizes of a map that grows to rows x cols, along its own aspect ratio; `start`: not larger in either way."""
    grown = growth_sizes(window, cols / rows, rows * cols, start)
    sizes = [size for size in grown if size[0] <= rows and size[1] <= cols]
    while sizes[-1] != (rows, cols):
        last_rows, last_cols = sizes[-1]
        sizes.append((last_rows, last_cols + 1) if last_cols < cols else (last_rows + 1, last_cols))
    return sizes


def growth_order(geometry: WindowGeometry, sizes: list[tuple[int, int]]) -> FillOrder:
    """The paper's order: the first window row by row, then whole columns (downwards) and whole rows (rightwards)."""
    rows, cols = sizes[-1]
    rank = np.empty((rows, cols), dtype=np.int32)
    start_rows, start_cols = sizes[0]
    rank[:start_rows, :start_cols] = np.arange(start_rows * start_cols).reshape(start_rows, start_cols)
    filled = start_rows * start_cols
    for (old_rows, old_cols), (new_rows, new_cols) in pairwise(sizes):
        if new_cols > old_cols:
            rank[:new_rows, old_cols] = filled + np.arange(new_rows)
            filled += new_rows
        else:
            rank[old_rows, :new_cols] = filled + np.arange(new_cols)
            filled += new_cols
    flat = rank.reshape(-1)
    count = (rows - 2 * geometry.margin) * (cols - 2 * geometry.margin)
    places, steps = np.empty(count, np.int32), np.empty(count, np.int32)
    for begin in range(0, count, _CHUNK):
        part = slice(begin, begin + _CHUNK)
        ranks = flat[geometry.cells(rows, cols, part)]
        places[part], steps[part] = ranks.argmax(axis=1), ranks.max(axis=1)
    by_step = np.argsort(steps, kind="stable")
    first = np.searchsorted(steps[by_step], np.arange(rows * cols + 1)).astype(np.int32)
    whole = np.zeros(rows * cols, np.uint8)
    whole[[size_rows * size_cols - 1 for size_rows, size_cols in sizes]] = 1
    return FillOrder(np.argsort(flat).astype(np.int32), first, by_step.astype(np.int32), places[by_step], whole)
