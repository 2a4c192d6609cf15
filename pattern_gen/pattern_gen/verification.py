"""Verification of a map, independent of the searches and exact at any size.

Windows and rotations are derived here from the spots' positions in the plane, not from the searches' tables. Two codes
at distance at most d agree on at least one of d + 1 parts of their cells: sorting by each part in turn brings every
such pair together, and every pair that meets is compared cell by cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pattern_gen.pattern import Grid

_PAIRS = 250_000  # compared at a time
_KEYS = 1_000_000  # sorted at a time: bounds the memory for large maps


@dataclass(frozen=True)
class Place:
    """A window by its centre and the rotation of its code, in steps of 90 (square) or 60 degrees (hexagonal)."""

    row: int
    col: int
    rotation: int = 0

    def describe(self, orientations: int) -> str:
        """For messages."""
        turned = f" turned by {self.rotation * 360 // orientations} deg" if self.rotation else ""
        return f"row {self.row}, column {self.col}{turned}"


@dataclass(frozen=True)
class Pair:
    """Two windows that are too close (or the closest ones)."""

    first: Place
    second: Place
    distance: int


@dataclass(frozen=True)
class Verification:
    """Result of a verification.

    Attributes:
        windows: number of windows, that is of codes.
        closest: a pair of different windows at the least distance over all rotations; None: fewer than two windows.
        own: the window closest to one of its own rotations; None without rotations.
        h, own_limit: what was asked for.
        orientations: rotations considered, 1: none.
    """

    windows: int
    closest: Pair | None
    own: Pair | None
    h: int
    own_limit: int
    orientations: int

    @property
    def problem(self) -> str | None:
        """What is wrong, with the two places; None: nothing."""
        for pair, limit, what in ((self.closest, self.h, "windows"), (self.own, self.own_limit, "own rotations")):
            if pair is not None and pair.distance < limit:
                first, second = pair.first.describe(self.orientations), pair.second.describe(self.orientations)
                if what == "windows":
                    return f"the windows at {first} and at {second} differ in {pair.distance} cells, not in {limit}"
                return f"the window at {first} differs from itself, {second}, in {pair.distance} cells, not in {limit}"
        return None


def _plane(grid: Grid, row: NDArray[np.int64], col: NDArray[np.int64]) -> NDArray[np.float64]:
    """(..., 2) positions (right, down) of cells at unit pitch."""
    if grid is Grid.SQUARE:
        return np.stack([col, row], axis=-1).astype(np.float64)
    return np.stack([col * np.sqrt(0.75), row + 0.5 * (col % 2)], axis=-1)


def _neighbourhood(grid: Grid, window: int, parity: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cells of a window about a centre in a column of the given parity, and the same for each rotation.

    Returns:
        offsets: (n, 2) row and column relative to the centre.
        turned: (orientations, n) index into offsets of what stands at each position after the rotation.
    """
    radius = window // 2
    span = np.arange(-radius, radius + 1)
    row, col = (values.reshape(-1) for values in np.meshgrid(span, span, indexing="ij"))
    origin = _plane(grid, np.array(0), np.array(parity))
    position = _plane(grid, row, col + parity) - origin
    if grid is Grid.HEXAGONAL:
        # inside the hexagon of this radius: no further than radius along each of the three directions across its sides
        angles = np.deg2rad([30.0, 90.0, 150.0])
        across = np.abs(position @ np.stack([np.cos(angles), np.sin(angles)])).max(axis=1)
        inside = across <= radius + 1e-9
        row, col, position = row[inside], col[inside], position[inside]
    # order by polar angle within rings, so that both parities list the same neighbours at the same index
    ring = np.round(np.hypot(position[:, 0], position[:, 1]), 6)
    angle = np.round(np.arctan2(position[:, 1], position[:, 0]), 6) % np.round(2 * np.pi, 6)
    order = np.lexsort((angle, ring))
    position = position[order]
    turns = []
    for k in range(grid.orientations):
        theta = 2 * np.pi * k / grid.orientations
        rotation = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
        gap = np.linalg.norm((position @ rotation.T)[:, None] - position[None], axis=2)
        turns.append(gap.argmin(axis=1))
    return np.stack([row[order], col[order]], axis=1), np.array(turns)


def window_codes(symbols: NDArray[np.uint8], grid: Grid, window: int, rotations: bool = True) -> NDArray[np.uint8]:
    """Codes of all windows.

    Returns:
        (n, orientations, windows) uint8, windows in row-major order; orientations is 1 without rotations.
    """
    radius = window // 2
    rows, cols = symbols.shape
    turned = _neighbourhood(grid, window, 0)[1]
    turned = turned if rotations else turned[:1]
    plain = np.empty((turned.shape[1], rows - 2 * radius, cols - 2 * radius), dtype=np.uint8)
    for parity in (0, 1):
        start = (radius + parity) % 2  # the first centre column of this parity is radius + start
        for i, (down, right) in enumerate(_neighbourhood(grid, window, parity)[0]):
            seen = symbols[radius + down : rows - radius + down, radius + right + start : cols - radius + right : 2]
            plain[i, :, start::2] = seen
    return plain.reshape(len(plain), -1)[turned.T]


def _keys(codes: NDArray[np.uint8], cells: NDArray[np.int64], alphabet: int) -> NDArray[Any]:
    """(m,) rank of the letters that (n, m) codes have at some cells: equal exactly where all of them are equal."""
    narrow = alphabet ** len(cells) < 2**31  # half the memory
    key: NDArray[Any] = np.zeros(codes.shape[1], dtype=np.int32 if narrow else np.int64)
    top = 1
    for cell in cells:
        if top * alphabet >= 2**62:  # does not fit: rank what there is
            key = np.unique(key, return_inverse=True)[1].astype(np.int64)
            top = len(key)
        key *= alphabet
        key += codes[cell]
        top *= alphabet
    return key


def _meetings(key: NDArray[Any], windows: int) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Pairs (i, j) of equal key with i an unrotated code, i < windows, in batches."""
    parts = -(-len(key) // _KEYS)
    for part in range(parts):
        members = np.flatnonzero(key % parts == part)
        for i, j in _equal_pairs(key[members], int(np.searchsorted(members, windows))):
            yield members[i], members[j]


def _equal_pairs(key: NDArray[Any], firsts: int) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Pairs (i, j) of equal key with i < firsts, in batches."""
    order = np.argsort(key, kind="stable")
    ranked = key[order]
    low = np.searchsorted(ranked, key[:firsts], side="left")
    high = np.searchsorted(ranked, key[:firsts], side="right")
    ends = np.cumsum(high - low)
    first = 0
    while first < firsts:
        before = int(ends[first - 1]) if first else 0
        last = max(first + 1, int(np.searchsorted(ends, before + _PAIRS, side="right")))
        counts = (high - low)[first:last]
        i = np.repeat(np.arange(first, last), counts)
        inside = np.arange(len(i)) - np.repeat(np.cumsum(counts) - counts, counts)
        yield i, order[np.repeat(low[first:last], counts) + inside]
        first = last


def _closest(codes: NDArray[np.uint8], width: int, alphabet: int, band: int | None) -> tuple[int, int, int] | None:
    """Two different windows at the least distance over all rotations; None: there is at most one.

    Args:
        codes: (n, orientations, windows) as of window_codes.
        width: windows in a row.
        band: None, or compare only windows at most so many rows apart.

    Returns:
        Index of the window, index of the other's code among those of all orientations, distance.
    """
    n, _, windows = codes.shape
    flat = codes.reshape(n, -1)
    for distance in range(n + 1):
        for part in np.array_split(np.arange(n), min(distance + 1, n)):
            cells = part if distance < n else part[:0]
            for i, j in _meetings(_keys(flat, cells, alphabet), windows):
                other = j % windows
                wanted = i != other
                if band is not None:
                    wanted &= np.abs(i // width - other // width) <= band
                i, j = i[wanted], j[wanted]
                gap = np.zeros(len(i), dtype=np.uint8)
                for cell in flat:
                    gap += cell[i] != cell[j]
                near = np.flatnonzero(gap <= distance)
                if len(near):
                    return int(i[near[0]]), int(j[near[0]]), int(gap[near[0]])
    return None


def verify_map(
    symbols: NDArray[np.uint8],
    *,
    grid: Grid,
    alphabet: int,
    h: int,
    own_limit: int,
    window: int = 3,
    rotations: bool = True,
    band: int | None = None,
) -> Verification:
    """Check that all windows differ in at least h cells over all rotations.

    Args:
        symbols: (rows, cols) map.
        own_limit: least distance of a window from its own rotations: 0 (BASE), 1 (STRICT) or h (SELFDIST).
        rotations: False: only the given orientation counts.
        band: None, or only windows at most so many rows apart need differ (epipolar restriction).
    """
    codes = window_codes(symbols, grid, window, rotations)
    _, orientations, windows = codes.shape
    width = symbols.shape[1] - window + 1

    def place(index: int) -> Place:
        turn, at = divmod(index, windows)
        return Place(window // 2 + at // width, window // 2 + at % width, turn)

    own: Pair | None = None
    for turn in range(1, orientations):
        gaps = np.zeros(windows, dtype=np.uint8)
        for cell in codes:
            gaps += cell[0] != cell[turn]
        k = int(gaps.argmin())
        if own is None or gaps[k] < own.distance:
            own = Pair(place(k), place(turn * windows + k), int(gaps[k]))
    found = _closest(codes, width, alphabet, band)
    closest = None if found is None else Pair(place(found[0]), place(found[1]), found[2])
    return Verification(windows, closest, own, h, own_limit, orientations)
