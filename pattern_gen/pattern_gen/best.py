"""`--method best`: depth-first search with back-jumping at fixed sizes that grow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pattern_gen import depth_first
from pattern_gen.errors import SearchError
from pattern_gen.fill_order import raster_order
from pattern_gen.generation import Clock, Found, Progress, Report, Request
from pattern_gen.search import Walker, most_windows
from pattern_gen.windows import window_geometry


def patience(alphabet: int) -> int:
    """Steps without progress before a back-jump; small alphabets need more."""
    return 10_000 if alphabet >= 5 else 50_000


class _Fixed:
    """Search for one size with changing seeds until it is found or time is over."""

    def __init__(self, request: Request, clock: Clock, report: Report | None) -> None:
        self.request, self.clock, self.report = request, clock, report
        self.best: NDArray[np.uint8] | None = None
        self.best_seconds = 0.0
        self.steps = 0
        self.exhausted = False

    def find(self, rows: int, cols: int, limit: float) -> bool:
        """Search until `limit` seconds on the clock; True when found (then in `best`)."""
        geometry = window_geometry(self.request.grid, self.request.window)
        order = raster_order(geometry, rows, cols)
        walker = Walker(self.request, order, cols, patience=patience(self.request.alphabet), seed=self.request.seed)
        status = depth_first.RUNNING
        while status == depth_first.RUNNING and self.clock.seconds < min(limit, self.clock.limit):
            status = walker.run(self.clock)
            if self.report is not None:
                best = None if self.best is None else self.best.shape
                self.report(Progress(rows, cols, walker.deepest / len(order.cells), best,  # type: ignore[arg-type]
                                     self.clock.seconds, self.steps + walker.steps))  # fmt: skip
        self.steps += walker.steps
        self.exhausted = status == depth_first.EXHAUSTED
        if status == depth_first.DONE:
            self.best, self.best_seconds = walker.best(rows, cols), self.clock.seconds
            return True
        return False


def size_ladder(window: int, aspect: float, limit: int) -> list[tuple[int, int]]:
    """Sizes (rows, cols) near an aspect ratio, growing: for each number of rows the nearest numbers of columns."""
    sizes: list[tuple[int, int]] = []
    rows = window
    while True:
        cols = [max(window, int(np.floor(aspect * rows))), max(window, int(np.floor(aspect * rows + 0.5)))]
        for size in ((rows, count) for count in sorted(set(cols))):
            if size[0] * size[1] > limit:
                return sizes or [(window, window)]
            sizes.append(size)
        rows += 1


def search_best(
    request: Request, rows: int | None, cols: int | None, aspect: float, clock: Clock, report: Report | None
) -> Found:
    """See search.search_map."""
    search = _Fixed(request, clock, report)
    if rows is not None and cols is not None:
        if not search.find(rows, cols, clock.limit):
            why = "no such map exists" if search.exhausted else f"not found within {clock.limit:g} s"
            raise SearchError(f"map {rows}x{cols} with {request.alphabet} letters and distance {request.h}: {why}")
        assert search.best is not None
        return Found(search.best, search.best_seconds, False, search.steps)
    margin = request.window - 1
    most = most_windows(request)
    sizes = [
        size
        for size in size_ladder(request.window, aspect, min(2 * most + 200, 25_000_000))
        if (size[0] - margin) * (size[1] - margin) <= most
    ] or [(request.window, request.window)]
    try:
        _climb(search, sizes, clock)
    except KeyboardInterrupt:
        if search.best is None:
            raise
    if search.best is None:
        raise SearchError(
            f"no map with {request.alphabet} letters and distance {request.h} was found within {clock.limit:g} s"
        )
    return Found(search.best, search.best_seconds, search.exhausted, search.steps)


def _climb(search: _Fixed, sizes: list[tuple[int, int]], clock: Clock) -> None:
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
