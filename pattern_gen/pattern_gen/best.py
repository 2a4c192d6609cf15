"""`--method best`: searches of different kinds take turns at a size; without a size, the size grows.

Depth-first search with back-jumping fills the square grid along its shorter side: the two lines that still matter are
then short, and back-tracking reaches them soon. On the hexagonal grid, where a cell's window mostly holds cells that
were filled long ago, and for large distances, the focused local search wins.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pattern_gen import depth_first
from pattern_gen.errors import SearchError
from pattern_gen.fill_order import growth_order, growth_to, raster_order
from pattern_gen.generation import Clock, Found, Progress, Report, Request
from pattern_gen.local_search import LocalSearch
from pattern_gen.pattern import Grid
from pattern_gen.search import SLICE, Walker, most_windows
from pattern_gen.windows import window_geometry

TEMPERATURES = {Grid.SQUARE: (0.46, 0.40), Grid.HEXAGONAL: (0.40, 0.46)}
MAX_REPAIR_WINDOWS = 100_000


class Searcher(Protocol):
    """A search for a map of one size, run in slices."""

    exhausted: bool

    @property
    def filled(self) -> float:
        """How far it is, 0 to 1."""
        ...

    @property
    def steps(self) -> int:
        """Steps taken."""
        ...

    def run(self, clock: Clock) -> bool:
        """Go on for about SLICE seconds; True: the map is found."""
        ...

    def result(self) -> NDArray[np.uint8]:
        """(rows, cols) the map found."""
        ...


class DepthFirst:
    """Depth-first search with back-jumping."""

    def __init__(self, request: Request, rows: int, cols: int, seed: int, *, ascending: bool = False) -> None:
        """`ascending`: the paper's order of cells and letters, which packs small alphabets well."""
        # a square map's mirror image is as good; rows keep their meaning under the epipolar restriction
        self._flipped = request.grid is Grid.SQUARE and cols > rows and request.band is None
        self._size = (cols, rows) if self._flipped else (rows, cols)
        geometry = window_geometry(request.grid, request.window)
        if ascending:
            self._flipped, self._size = False, (rows, cols)
            order = growth_order(geometry, growth_to(request.window, rows, cols))
        else:
            order = raster_order(geometry, *self._size)
        patience = 0 if ascending else 10_000 if request.alphabet >= 5 else 50_000
        self._walker = Walker(request, order, self._size[1], patience=patience, seed=seed)
        self.exhausted = False

    def run(self, clock: Clock) -> bool:
        """See Searcher."""
        status = self._walker.run(clock)
        self.exhausted = status == depth_first.EXHAUSTED
        return status == depth_first.DONE

    @property
    def filled(self) -> float:
        """Part of the cells that were filled at once."""
        return self._walker.deepest / (self._size[0] * self._size[1])

    @property
    def steps(self) -> int:
        """Steps taken."""
        return self._walker.steps

    def result(self) -> NDArray[np.uint8]:
        """See Searcher."""
        symbols = self._walker.best(*self._size)
        return np.ascontiguousarray(symbols.T) if self._flipped else symbols


class Repair:
    """Focused local search from a random map."""

    exhausted = False

    def __init__(self, request: Request, rows: int, cols: int, seed: int, temperature: float) -> None:
        geometry = window_geometry(request.grid, request.window)
        random = np.random.default_rng(abs(seed) + 1)
        start = random.integers(0, request.alphabet, (rows, cols)).astype(np.uint8)
        self._search = LocalSearch(
            start,
            geometry=geometry,
            alphabet=request.alphabet,
            h=request.h,
            own=request.own,
            turns=request.orientations,
            seed=seed,
        )
        self._temperature = temperature
        self._windows = (rows - 2 * geometry.margin) * (cols - 2 * geometry.margin)
        self._slice = 2_000

    def run(self, clock: Clock) -> bool:
        """See Searcher."""
        begin = clock.seconds
        done = self._search.run(self._slice, self._temperature)
        elapsed = max(clock.seconds - begin, 1e-4)
        self._slice = int(np.clip(self._slice * SLICE / elapsed, 0.2 * self._slice, 5 * self._slice)) + 1
        return done

    @property
    def filled(self) -> float:
        """Part of the windows without a conflict."""
        return 1.0 - int(self._search.state.counters[0]) / self._windows

    @property
    def steps(self) -> int:
        """Steps taken."""
        return self._search.steps

    def result(self) -> NDArray[np.uint8]:
        """See Searcher."""
        return self._search.symbols.copy()


def searchers(request: Request, rows: int, cols: int) -> list[Searcher]:
    """The searches that take turns for a size, the most promising first."""
    kinds: list[Searcher] = [DepthFirst(request, rows, cols, request.seed)]
    margin = request.window - 1
    small = (rows - margin) * (cols - margin) <= MAX_REPAIR_WINDOWS
    cells = rows * cols
    if request.h >= 2 and request.band is None and small:
        if request.grid is Grid.HEXAGONAL:
            for turn, temperature in enumerate(TEMPERATURES[Grid.HEXAGONAL]):
                kinds.append(Repair(request, rows, cols, request.seed + turn, temperature))
        elif request.h >= 4:
            kinds.append(DepthFirst(request, rows, cols, request.seed + 1))
            kinds.append(Repair(request, rows, cols, request.seed, TEMPERATURES[Grid.SQUARE][0]))
        elif cells < 2_000:
            kinds.append(DepthFirst(request, rows, cols, request.seed + 1))
    elif request.h == 1 and request.band is None and cells < 300:
        kinds.append(Repair(request, rows, cols, request.seed, 0.3))
    if cells < 300:
        kinds.append(DepthFirst(request, rows, cols, request.seed, ascending=True))
    return kinds


class _Search:
    """Finds one size after the other and keeps the best."""

    def __init__(self, request: Request, clock: Clock, report: Report | None) -> None:
        self.request, self.clock, self.report = request, clock, report
        self.best: NDArray[np.uint8] | None = None
        self.best_seconds = 0.0
        self.steps = 0
        self.exhausted = False

    def find(self, rows: int, cols: int, limit: float) -> bool:
        """Search until `limit` seconds on the clock; True when found (then in `best`)."""
        kinds = searchers(self.request, rows, cols)
        turn = 0
        while self.clock.seconds < min(limit, self.clock.limit) or turn == 0:
            kind = kinds[turn % len(kinds)]
            found = kind.run(self.clock)
            turn += 1
            self.exhausted = kind.exhausted
            if self.report is not None:
                best = None if self.best is None else (int(self.best.shape[0]), int(self.best.shape[1]))
                steps = self.steps + sum(other.steps for other in kinds)
                self.report(Progress(rows, cols, kind.filled, best, self.clock.seconds, steps))
            if found:
                self.best, self.best_seconds = kind.result(), self.clock.seconds
                break
            if self.exhausted:
                break
        self.steps += sum(kind.steps for kind in kinds)
        return self.best is not None and self.best.shape == (rows, cols)


def size_ladder(window: int, aspect: float, limit: int) -> list[tuple[int, int]]:
    """Sizes (rows, cols) near an aspect ratio, growing: for each number of rows the nearest numbers of columns.

    Args:
        limit: greatest number of cells.
    """
    sizes: list[tuple[int, int]] = []
    rows = window
    while True:
        low, high = int(np.floor(aspect * rows)), int(np.floor(aspect * rows + 0.5))
        for cols in sorted({max(window, low), max(window, high)}):
            if rows * cols > limit:
                return sizes or [(window, window)]
            sizes.append((rows, cols))
        rows += 1


def search_best(
    request: Request, rows: int | None, cols: int | None, aspect: float, clock: Clock, report: Report | None
) -> Found:
    """See search.search_map."""
    search = _Search(request, clock, report)
    if rows is not None and cols is not None:
        if not search.find(rows, cols, clock.limit):
            why = "no such map exists" if search.exhausted else f"not found within {clock.limit:g} s"
            hint = "" if search.exhausted else "; give it more time, a smaller size or more letters"
            raise SearchError(
                f"map {rows}x{cols} with {request.alphabet} letters and distance {request.h}: {why}{hint}"
            )
    else:
        margin = request.window - 1
        most = most_windows(request)
        ladder = size_ladder(request.window, aspect, min(2 * most + 200, 25_000_000))
        sizes = [size for size in ladder if (size[0] - margin) * (size[1] - margin) <= most]
        try:
            _climb(search, sizes or [(request.window, request.window)], clock)
        except KeyboardInterrupt:
            if search.best is None:
                raise
    if search.best is None:
        raise SearchError(
            f"no map with {request.alphabet} letters and distance {request.h} was found within {clock.limit:g} s"
        )
    return Found(search.best, search.best_seconds, False, search.steps)


def _climb(search: _Search, sizes: list[tuple[int, int]], clock: Clock) -> None:
    """Larger and larger sizes: in leaps while it is easy, then one by one with the time that is left."""
    low, high, leap = -1, len(sizes), 1
    while low + 1 < high and not clock.over:
        target = min(low + leap, high - 1)
        share = 1.0 if target == low + 1 else 0.15
        if search.find(*sizes[target], clock.seconds + share * (clock.limit - clock.seconds)):
            low, leap = target, leap * 2
        elif search.exhausted:
            high, leap = target, 1
        else:
            leap = max(1, leap // 4)
