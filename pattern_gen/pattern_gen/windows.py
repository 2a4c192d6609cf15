"""Geometry of windows: which cells a window holds, in which order, and how rotations permute them. Both grids.

A window is named by its centre cell. Its n cells are listed in the order in which a search fills them, so the last one
is the cell that completes the window: row by row on the square grid, column by column on the hexagonal grid, where each
new cell then completes exactly one window.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from pattern_gen.pattern import Grid


@dataclass(frozen=True, eq=False)
class WindowGeometry:
    """Cells of a window and their permutations.

    Attributes:
        grid: kind of grid.
        window: window size w; the windows' centres lie w // 2 cells inside the map.
        offsets: (2, n, 2) int64: (row, col) of each cell relative to the centre, for even and odd centre columns. The
            column offsets are the same for both.
        rotations: (orientations, n) int64: code of the window rotated k times = code[rotations[k]]; k = 0: identity.
    """

    grid: Grid
    window: int
    offsets: NDArray[np.int64]
    rotations: NDArray[np.int64]

    @property
    def size(self) -> int:
        """Number of cells n in a window: w * w, or 7 for a hexagon and its centre."""
        return int(self.offsets.shape[1])

    @property
    def margin(self) -> int:
        """Number of rows and columns at the border that are no centres."""
        return self.window // 2

    def cells(self, rows: int, cols: int, part: slice = slice(None)) -> NDArray[np.int64]:
        """(windows, n) flat cell indices of every window of a rows x cols map, in row-major order of the centres.

        `part`: of these windows only.
        """
        width = cols - 2 * self.margin
        centre = np.arange((rows - 2 * self.margin) * width)[part]
        row, col = self.margin + centre // width, self.margin + centre % width
        offsets = self.offsets[col % 2]
        return (row[:, None] + offsets[..., 0]) * cols + col[:, None] + offsets[..., 1]


def _square(window: int) -> WindowGeometry:
    margin = window // 2
    cells = [(row, col) for row in range(-margin, margin + 1) for col in range(-margin, margin + 1)]
    index = {cell: i for i, cell in enumerate(cells)}
    quarter = np.array([index[(-col, row)] for row, col in cells])
    rotations = [np.arange(len(cells))]
    for _ in range(3):
        rotations.append(rotations[-1][quarter])
    offsets = np.array([cells, cells], dtype=np.int64)
    return WindowGeometry(Grid.SQUARE, window, offsets, np.array(rotations, dtype=np.int64))


def _hexagonal(window: int) -> WindowGeometry:
    """Axial coordinates (q along the columns, r down the rows): a column further right starts half a row lower."""
    radius = window // 2
    span = range(-radius, radius + 1)
    axial = sorted((q, r) for q in span for r in span if abs(q + r) <= radius)
    index = {cell: i for i, cell in enumerate(axial)}
    sixth = np.array([index[(-r, q + r)] for q, r in axial])
    rotations = [np.arange(len(axial))]
    for _ in range(5):
        rotations.append(rotations[-1][sixth])
    # height in rows = r + q / 2; a cell in an odd column lies half a row lower than its row number says
    offsets = [[(r + (q + parity) // 2, q) for q, r in axial] for parity in (0, 1)]
    return WindowGeometry(
        Grid.HEXAGONAL, window, np.array(offsets, dtype=np.int64), np.array(rotations, dtype=np.int64)
    )


@cache
def window_geometry(grid: Grid, window: int = 3) -> WindowGeometry:
    """The geometry of windows of odd size `window` >= 3 on a grid."""
    return _square(window) if grid is Grid.SQUARE else _hexagonal(window)
