"""`--method best`: searches of different kinds take turns at a size; without a size, the size grows.

Turns are counted in steps and not in time: what is found, and in which order, depends on the seed alone; the time
limit only ends the search. Depth-first search fills the square grid along its shorter side: the two lines that still
matter are then short, and back-tracking reaches them soon. For h >= 2 on the square grid the search line by line goes
furthest, and for up to a thousand windows or two the search for maps whose letters shift. On the hexagonal grid, where
a cell's window mostly holds cells that were filled long ago, the focused local search wins.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pattern_gen import depth_first
from pattern_gen.errors import SearchError
from pattern_gen.fill_order import growth_order, growth_to, raster_order
from pattern_gen.line_search import MAX_ALPHABET as MAX_LINE_ALPHABET
from pattern_gen.line_search import LineSearch
from pattern_gen.local_search import LocalSearch
from pattern_gen.pattern import Grid
from pattern_gen.search_request import Clock, Found, Progress, Report, Request, most_windows
from pattern_gen.shifted_letters import ShiftedLetters
from pattern_gen.walker import Slices, Walker
from pattern_gen.windows import window_geometry

TEMPERATURES = {Grid.SQUARE: (0.46, 0.40), Grid.HEXAGONAL: (0.40, 0.46)}
MAX_REPAIR_WINDOWS = 100_000
MAX_SHIFTED_WINDOWS = 3_000
SMALL_CELLS = 300  # of maps for which the ascending orders are worth a try
DEVIATION, DEVIATION_PATIENCE = 0.05, 100_000  # of the ascending order that differs from seed to seed
FALLING_WEIGHTS = (0.5, 0.35)  # of the letters, see line_search
CANDIDATES = 20


class Searcher(Protocol):
    """A search for a map of one size."""

    exhausted: bool
    turn_steps: int  # steps until the next kind has its turn: about half a second

    @property
    def filled(self) -> float:
        """How far it is, 0 to 1."""
        ...

    @property
    def steps(self) -> int:
        """Steps taken."""
        ...

    def run(self, steps: int) -> bool:
        """Go on for about so many steps; True: the map is found."""
        ...

    def result(self) -> NDArray[np.uint8]:
        """(rows, cols) the map found."""
        ...


def _lying(request: Request, rows: int, cols: int) -> bool:
    """A map is searched transposed, along its shorter side: a square map's mirror image is as good."""
    return request.grid is Grid.SQUARE and cols > rows and request.band is None  # a band is about rows


class DepthFirst:
    """Depth-first search: at random with back-jumping, in ascending order with rare deviations, or as the paper."""

    def __init__(
        self, request: Request, rows: int, cols: int, seed: int, *, deviation: float = 1.0, growth: bool = False
    ) -> None:
        """`deviation`: see search_rules.Rules, 0: no back-jumping either; `growth`: the paper's order of cells."""
        self._flipped = _lying(request, rows, cols) and not growth
        self._size = (cols, rows) if self._flipped else (rows, cols)
        geometry = window_geometry(request.grid, request.window)
        if growth:
            order = growth_order(geometry, growth_to(request.window, rows, cols))
        else:
            order = raster_order(geometry, *self._size)
        patience = 10_000 if request.alphabet >= 5 else 50_000
        if deviation < 1.0:
            patience = DEVIATION_PATIENCE if deviation > 0.0 else 0
        self.turn_steps = max(300_000 if deviation == 1.0 else 1_000_000, 4 * rows * cols)
        self._walker = Walker(request, order, self._size[1], patience=patience, deviation=deviation, seed=seed)
        self.exhausted = False

    def run(self, steps: int) -> bool:
        """See Searcher."""
        status = self._walker.run(steps)
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


class LineByLine:
    """Search line by line along the shorter side; see line_search."""

    exhausted = False
    turn_steps = 100_000

    def __init__(self, request: Request, rows: int, cols: int, seed: int, falling: float) -> None:
        self._flipped = _lying(request, rows, cols)
        self._lines, width = (cols, rows) if self._flipped else (rows, cols)
        self._search = LineSearch(
            self._lines, width, alphabet=request.alphabet, h=request.h, own=request.own, turns=request.orientations,
            seed=seed, falling=falling, candidates=CANDIDATES,
        )  # fmt: skip

    def run(self, steps: int) -> bool:
        """See Searcher."""
        return self._search.run(steps)

    @property
    def filled(self) -> float:
        """Part of the lines that were filled at once."""
        return self._search.deepest / self._lines

    @property
    def steps(self) -> int:
        """Steps taken."""
        return self._search.steps

    def result(self) -> NDArray[np.uint8]:
        """See Searcher."""
        symbols = self._search.symbols
        return np.ascontiguousarray(symbols.T if self._flipped else symbols)


class Repair:
    """Focused local search from a random map."""

    exhausted = False
    turn_steps = 30_000

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

    def run(self, steps: int) -> bool:
        """See Searcher."""
        return self._search.run(steps, self._temperature)

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


def searchers(request: Request, rows: int, cols: int) -> list[Callable[[], Searcher]]:
    """The searches that take turns for a size, the quickest to try first; each is made when its first turn comes."""
    seed = request.seed
    kinds: list[Callable[[], Searcher]] = [lambda: DepthFirst(request, rows, cols, seed)]
    margin = request.window - 1
    windows = (rows - margin) * (cols - margin)
    if rows * cols < SMALL_CELLS:
        kinds.append(lambda: DepthFirst(request, rows, cols, seed, deviation=0.0))
        kinds.append(lambda: DepthFirst(request, rows, cols, seed, deviation=DEVIATION))
    if request.h >= 2 and request.band is None:
        square = request.grid is Grid.SQUARE
        if square and windows <= MAX_SHIFTED_WINDOWS:
            for downwards in (False, True):
                kinds.append(
                    lambda downwards=downwards: ShiftedLetters(request, rows, cols, downwards=downwards)  # type: ignore[misc]
                )
        if square and request.window == 3 and request.alphabet <= MAX_LINE_ALPHABET:
            for turn, falling in enumerate(FALLING_WEIGHTS):
                kinds.append(
                    lambda turn=turn, falling=falling: LineByLine(request, rows, cols, seed + turn, falling)  # type: ignore[misc]
                )
        if windows <= MAX_REPAIR_WINDOWS and (not square or request.h >= 4):
            for turn, temperature in enumerate(TEMPERATURES[request.grid]):
                kinds.append(
                    lambda turn=turn, temperature=temperature: Repair(request, rows, cols, seed + turn, temperature)  # type: ignore[misc]
                )
    if rows * cols < SMALL_CELLS:
        kinds.append(lambda: DepthFirst(request, rows, cols, seed, deviation=0.0, growth=True))
    return kinds


class _Search:
    """Finds one size after the other and keeps the best."""

    def __init__(self, request: Request, clock: Clock, report: Report | None) -> None:
        self.request, self.clock, self.report = request, clock, report
        self.best: NDArray[np.uint8] | None = None
        self.best_seconds = 0.0
        self.steps = 0
        self.exhausted = False

    def find(self, rows: int, cols: int, rounds: int | None = None) -> bool:
        """Search until the time is over, or for so many turns of every kind; True when found (then in `best`)."""
        makers = searchers(self.request, rows, cols)
        kinds: list[Searcher] = []
        slices: list[Slices] = []
        self.exhausted = False
        for turn in cycle(range(len(makers))):
            if turn == 0 and rounds is not None:
                rounds -= 1
                if rounds < 0:
                    break
            if turn == len(kinds):
                kinds.append(makers[turn]())
                slices.append(Slices(2_000))
            if self._take_turn(kinds[turn], slices[turn], (rows, cols)) or self.clock.over or self.exhausted:
                break
        self.steps += sum(kind.steps for kind in kinds)
        return self.best is not None and self.best.shape == (rows, cols)

    def _take_turn(self, kind: Searcher, slices: Slices, size: tuple[int, int]) -> bool:
        end = kind.steps + kind.turn_steps
        while kind.steps < end:
            begin = self.clock.seconds
            found = kind.run(min(slices.steps, end - kind.steps))
            slices.took(self.clock.seconds - begin)
            self.exhausted = kind.exhausted
            if found:
                self.best, self.best_seconds = kind.result(), self.clock.seconds
            if self.report is not None:
                best = None if self.best is None else (int(self.best.shape[0]), int(self.best.shape[1]))
                self.report(Progress(*size, kind.filled, best, self.clock.seconds, self.steps + kind.steps))
            if found or self.exhausted or self.clock.over:
                return found
        return False


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
    interrupted = False
    if rows is not None and cols is not None:
        if not search.find(rows, cols):
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
            interrupted = True
            if search.best is None:
                raise
    if search.best is None:
        raise SearchError(
            f"no map with {request.alphabet} letters and distance {request.h} was found within {clock.limit:g} s"
        )
    return Found(search.best, search.best_seconds, False, search.steps, interrupted)


def _climb(search: _Search, sizes: list[tuple[int, int]], clock: Clock) -> None:
    """Larger and larger sizes: in leaps while it is easy, then one by one with the time that is left."""
    low, high, leap = -1, len(sizes), 1
    while low + 1 < high and not clock.over:
        target = min(low + leap, high - 1)
        if search.find(*sizes[target], rounds=None if target == low + 1 else 1):
            low, leap = target, leap * 2
        elif search.exhausted:
            high, leap = target, 1
        else:
            leap = max(1, leap // 4)
