"""Generation of maps: what to search for (Request), the searches by size, and the pattern around the map."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from pattern_gen.errors import SearchError
from pattern_gen.pattern import MAX_ALPHABET, Grid, Letter, Pattern, fit_to_projector


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


def generate(
    letters: int | Sequence[Letter],
    hamming: int = 1,
    *,
    grid: Grid | str = Grid.SQUARE,
    window: int = 3,
    rows: int | None = None,
    cols: int | None = None,
    aspect: float | None = None,
    method: str = "best",
    reading: Reading | str = Reading.STRICT,
    invariant: bool = True,
    band: int | None = None,
    seed: int = 0,
    time_limit: float = 10.0,
    projector: tuple[int, int] = (1024, 768),
    cache: bool = True,
    report: Report | None = None,
) -> Pattern:
    """Generate a pattern.

    Args:
        letters: the alphabet's size (letters are then chosen and assigned, see letters and assignment) or the letters
            themselves, which are kept as they are.
        hamming: least Hamming distance h between windows.
        rows, cols: size of the map; both or neither.
        aspect: without a size: image width over height of the map to grow; None: the projector's.
        method: "paper" (section II.B as written) or "best" (the strongest search).
        reading, invariant, band, seed: see Request.
        time_limit: in [s]; a search without a size returns the largest map found by then.
        projector: width and height of the projector image in [px].
        cache: read a map that was found before from the user's cache, and keep the one found; see map_cache.
        report: called with the Progress.

    Returns:
        The pattern, as large as fits into the projector image.

    Raises:
        SearchError: an impossible request, or a map of the size asked for was not found in time.
    """
    from pattern_gen.assignment import assign_letters
    from pattern_gen.letters import choose_letters
    from pattern_gen.map_cache import cached_search

    alphabet = choose_letters(letters) if isinstance(letters, int) else tuple(letters)
    request = Request(
        alphabet=len(alphabet), h=hamming, grid=Grid(grid), window=window, reading=Reading(reading),
        invariant=invariant, band=band, seed=seed,
    )  # fmt: skip
    image_aspect = projector[0] / projector[1] if aspect is None else aspect
    found = cached_search(
        request, rows=rows, cols=cols, aspect=image_aspect, method=method, time_limit=time_limit, cache=cache,
        report=report,
    )  # fmt: skip
    if isinstance(letters, int):
        alphabet = assign_letters(found.symbols, alphabet, request)
    return pattern_of(found.symbols, request, alphabet, projector)


def enlarge(
    pattern: Pattern,
    *,
    rows: int | None = None,
    cols: int | None = None,
    aspect: float | None = None,
    method: str = "best",
    reading: Reading | str = Reading.STRICT,
    seed: int = 0,
    time_limit: float = 10.0,
    projector: tuple[int, int] | None = None,
    cache: bool = True,
    report: Report | None = None,
) -> Pattern:
    """A larger pattern whose top left part is a given one, with the same letters (section II.B).

    Args:
        pattern: the pattern to enlarge.
        rows, cols, aspect, method, seed, time_limit, cache, report: as generate.
        reading: condition on own rotations, which the given pattern must satisfy as well.
        projector: width and height of the projector image in [px]; None: the pattern's.

    Raises:
        SearchError: the given pattern breaks the rules, the size is smaller, or was not reached in time.
    """
    from pattern_gen.map_cache import cached_search

    request = request_of(pattern, Reading(reading), seed)
    projector = projector or (pattern.projector_width, pattern.projector_height)
    found = cached_search(
        request, rows=rows, cols=cols, aspect=projector[0] / projector[1] if aspect is None else aspect,
        method=method, time_limit=time_limit, start=pattern.symbols, cache=cache, report=report,
    )  # fmt: skip
    return pattern_of(found.symbols, request, pattern.letters, projector)


def request_of(pattern: Pattern, reading: Reading, seed: int) -> Request:
    """The request that a pattern fulfils."""
    return Request(
        alphabet=pattern.alphabet, h=pattern.min_hamming, grid=pattern.grid, window=pattern.window, reading=reading,
        seed=seed,
    )  # fmt: skip


def pattern_of(
    symbols: NDArray[np.uint8], request: Request, letters: tuple[Letter, ...], projector: tuple[int, int]
) -> Pattern:
    """The pattern that shows a map found for a request."""
    return fit_to_projector(
        symbols,
        letters,
        grid=request.grid,
        window=request.window,
        min_hamming=request.h,
        projector_width=projector[0],
        projector_height=projector[1],
    )


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
