"""What is searched for, what a search reports, and its bounds in size and time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from math import comb

import numpy as np
from numpy.typing import NDArray

from pattern_gen.errors import SearchError
from pattern_gen.pattern import MAX_ALPHABET, Grid


class Reading(Enum):
    """What a window must satisfy against its own rotations; between different windows the paper's rule always holds.

    BASE: nothing; a window that equals its own rotation then gives the position but not the orientation.
    STRICT: it differs from its own rotations; the only reading that fits the paper's exhausted cells.
    SELFDIST: it differs from them in at least h cells; the orientation survives h - 1 errors, too.
    """

    BASE = "base"
    STRICT = "strict"
    SELFDIST = "selfdist"

    def own_distance(self, h: int) -> int:
        """Least distance of a window from its own rotations."""
        return {Reading.BASE: 0, Reading.STRICT: 1, Reading.SELFDIST: h}[self]


@dataclass(frozen=True, kw_only=True)
class Request:
    """What to search for.

    Attributes:
        alphabet: number of letters, 2..36.
        h: least Hamming distance between any two windows over all rotations.
        grid: SQUARE or HEXAGONAL.
        window: window size, odd.
        reading: see Reading.
        invariant: False: the camera's roll is known, only windows in the same orientation need differ (section II.B).
        band: None: all windows differ. k: windows more than k rows apart may be equal, since the epipolar lines, which
            run along the rows once the projector is calibrated, tell them apart.
        seed: of the random choices; the same seed gives the same map.
    """

    alphabet: int
    h: int = 1
    grid: Grid = Grid.SQUARE
    window: int = 3
    reading: Reading = Reading.STRICT
    invariant: bool = True
    band: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        cells = window_cells(self.grid, self.window)
        if not 2 <= self.alphabet <= MAX_ALPHABET:
            raise SearchError(f"{self.alphabet} letters: an alphabet has 2 to {MAX_ALPHABET}")
        if self.window < 3 or self.window % 2 == 0:
            raise SearchError(f"window {self.window} must be odd and at least 3")
        if not 1 <= self.h <= cells:
            raise SearchError(
                f"Hamming distance {self.h} is impossible: a window has {cells} cells; ask for 1 to {cells}"
            )
        if self.band is not None and self.band < 0:
            raise SearchError(f"band {self.band} must be 0 rows or more")

    @property
    def orientations(self) -> int:
        """Rotations that count."""
        return self.grid.orientations if self.invariant else 1

    @property
    def own(self) -> int:
        """Least distance of a window from its own rotations."""
        return self.reading.own_distance(self.h) if self.invariant else 0


@dataclass
class Progress:
    """Where a search stands; handed to the caller's `report` a few times a second."""

    rows: int
    cols: int
    filled: float
    best: tuple[int, int] | None
    seconds: float
    steps: int


@dataclass(frozen=True, eq=False)
class Found:
    """Result of a search.

    Attributes:
        symbols: (rows, cols) uint8.
        seconds: until this map was found.
        exhausted: the search space ended: no larger map of this kind exists.
        steps: steps taken in all.
        interrupted: the user stopped the search: with more time a larger map may follow.
        cached: the map was found before; seconds, exhausted and steps are of that search.
    """

    symbols: NDArray[np.uint8]
    seconds: float
    exhausted: bool = False
    steps: int = 0
    interrupted: bool = False
    cached: bool = False

    @property
    def size(self) -> tuple[int, int]:
        """(rows, cols)."""
        return int(self.symbols.shape[0]), int(self.symbols.shape[1])


Report = Callable[[Progress], None]


def window_cells(grid: Grid, window: int) -> int:
    """Number of cells of a window."""
    radius = window // 2
    return window * window if grid is Grid.SQUARE else 3 * radius * (radius + 1) + 1


def parse_aspect(text: str) -> float:
    """Columns over rows of a 'W:H' or a plain number."""
    try:
        if ":" in text:
            width, height = (float(part) for part in text.split(":"))
            ratio = width / height
        else:
            ratio = float(text)
    except (ValueError, ZeroDivisionError):
        raise SearchError(f"aspect {text!r} must be like 4:3 or 1.333") from None
    if not 0.01 <= ratio <= 100:
        raise SearchError(f"aspect {text!r} must lie between 1:100 and 100:1")
    return ratio


def most_windows(request: Request) -> int:
    """Upper bound of the number of windows: Hamming and Singleton bound."""
    cells = window_cells(request.grid, request.window)
    a, h = request.alphabet, request.h
    ball = sum(comb(cells, i) * (a - 1) ** i for i in range((h - 1) // 2 + 1))
    codes = min(a**cells // ball, a ** (cells - h + 1))
    if request.orientations == 1:
        return codes
    # only where a window's own rotations are h apart, too, does each window take up one code for every orientation
    return codes // request.orientations if request.own >= request.h else codes


class Clock:
    """Time since the start of a search, and its limit."""

    def __init__(self, limit: float, *, processor: bool = False) -> None:
        """`processor`: count the processor's time spent on this process, whatever else the machine is busy with."""
        self._now = time.process_time if processor else time.monotonic
        self.start = self._now()
        self.limit = limit

    @property
    def seconds(self) -> float:
        """Elapsed time in [s]."""
        return self._now() - self.start

    @property
    def over(self) -> bool:
        """The limit has been reached."""
        return self.seconds >= self.limit
