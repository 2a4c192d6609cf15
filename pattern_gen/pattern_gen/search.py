"""Searches driven in slices, so that they report, stop and keep the best; `--method paper`."""

from __future__ import annotations

from math import comb

import numpy as np
from numpy.typing import NDArray

from pattern_gen import depth_first, near_codes, unique_codes
from pattern_gen.errors import SearchError
from pattern_gen.fill_order import HEXAGONAL_ASPECT, FillOrder, growth_order, growth_sizes, growth_to
from pattern_gen.generation import Clock, Found, Progress, Report, Request
from pattern_gen.pattern import Grid
from pattern_gen.search_rules import DEEPEST, STEPS, Rules
from pattern_gen.windows import window_geometry

SLICE = 0.15  # [s] between reports
FIRST_STEPS = 20_000


class Slices:
    """Numbers of steps that take about SLICE seconds: how often a search reports, never what it finds."""

    def __init__(self, first: int = FIRST_STEPS) -> None:
        self.steps = first

    def took(self, seconds: float) -> None:
        """Adapt to the time that `steps` steps took."""
        self.steps = int(np.clip(self.steps * SLICE / max(seconds, 1e-4), 0.2 * self.steps, 5 * self.steps)) + 1


class Walker:
    """One depth-first search."""

    def __init__(
        self, request: Request, order: FillOrder, cols: int, *, patience: int, deviation: float, seed: int
    ) -> None:
        """`patience`, `deviation`: see search_rules.Rules."""
        geometry = window_geometry(request.grid, request.window)
        band = -1 if request.band is None else request.band
        rules = Rules(cols, request.alphabet, request.h, request.own, band, patience, deviation)
        self.order, self.rules = order, rules
        prepare = unique_codes.prepare_unique if request.h == 1 and band < 0 else near_codes.prepare
        self.state: near_codes.State | unique_codes.State = prepare(
            order, rules, geometry=geometry, turns=request.orientations, seed=seed
        )

    def adopt(self, symbols: NDArray[np.uint8], cells: int) -> None:
        """Keep the first `cells` cells, in the order of filling, of a flat map."""
        depth_first.adopt(self.state, self.order, self.rules, symbols, cells)

    def run(self, steps: int) -> int:
        """Go on for up to so many steps; returns depth_first.RUNNING, DONE or EXHAUSTED."""
        return int(depth_first.search(self.state, self.order, self.rules, steps))

    @property
    def steps(self) -> int:
        """Steps taken."""
        return int(self.state.counters[STEPS])

    @property
    def deepest(self) -> int:
        """Most cells that were ever filled."""
        return int(self.state.counters[DEEPEST])

    def best(self, rows: int, cols: int) -> NDArray[np.uint8]:
        """The top left rows x cols cells of the largest whole map so far."""
        return self.state.best.reshape(-1, self.rules.cols)[:rows, :cols].copy()


def map_aspect(request: Request, image_aspect: float) -> float:
    """Columns over rows of a map that fills an image: hexagonal columns are closer together (section II.D)."""
    return image_aspect if request.grid is Grid.SQUARE else image_aspect * 0.75 * HEXAGONAL_ASPECT


def most_windows(request: Request) -> int:
    """Upper bound of the number of windows: Hamming and Singleton bound."""
    cells = window_geometry(request.grid, request.window).size
    a, h = request.alphabet, request.h
    ball = sum(comb(cells, i) * (a - 1) ** i for i in range((h - 1) // 2 + 1))
    codes = min(a**cells // ball, a ** (cells - h + 1))
    if request.orientations == 1:
        return codes
    # only where a window's own rotations are h apart, too, does each window take up one code for every orientation
    return codes // request.orientations if request.own >= request.h else codes


def search_map(
    request: Request,
    *,
    rows: int | None = None,
    cols: int | None = None,
    aspect: float = 4 / 3,
    method: str = "best",
    time_limit: float = 10.0,
    processor_time: bool = False,
    report: Report | None = None,
) -> Found:
    """Search for a map of a given size, or for the largest one of an aspect ratio.

    Args:
        rows, cols: the size; both or neither.
        aspect: width over height of the image that the map fills, used without a size.
        method: "paper" or "best".
        time_limit: in [s].
        processor_time: the limit is on the processor's time instead of the clock's.
        report: called about every SLICE seconds.

    Raises:
        SearchError: an impossible request, or the size was not reached in time.
    """
    if method not in ("paper", "best"):
        raise SearchError(f"unknown method {method!r}; known: paper, best")
    if (rows is None) != (cols is None):
        raise SearchError("give both rows and cols, or neither and an aspect ratio")
    clock = Clock(time_limit, processor=processor_time)
    if rows is not None and cols is not None:
        if min(rows, cols) < request.window:
            raise SearchError(f"a map of {rows}x{cols} holds no {request.window}x{request.window} window")
        margin = request.window - 1
        windows, most = (rows - margin) * (cols - margin), most_windows(request)
        if request.band is None and windows > most:
            raise SearchError(
                f"{rows}x{cols} has {windows} windows, at most {most} codes of {request.alphabet} letters can differ "
                f"in {request.h} cells over all rotations; ask for a smaller map, more letters or a smaller distance"
            )
    if method == "paper":
        return _paper(request, rows, cols, map_aspect(request, aspect), clock, report)
    from pattern_gen.best import search_best

    return search_best(request, rows, cols, map_aspect(request, aspect), clock, report)


def _paper(
    request: Request, rows: int | None, cols: int | None, aspect: float, clock: Clock, report: Report | None
) -> Found:
    """Section II.B as written: lowest letter first, chronological back-tracking, growth by columns and rows."""
    geometry = window_geometry(request.grid, request.window)
    if rows is not None and cols is not None:
        sizes = growth_to(request.window, rows, cols)
    else:
        limit = 1_500_000 if request.h == 1 and request.band is None else 60_000
        sizes = growth_sizes(request.window, aspect, min(limit, 2 * most_windows(request) + 200))
    order = growth_order(geometry, sizes)
    total_cols = sizes[-1][1]
    walker = Walker(request, order, total_cols, patience=0, deviation=0.0, seed=0)
    ends = np.array([size[0] * size[1] for size in sizes])
    reached, best_seconds = -1, 0.0
    slices = Slices()
    status = depth_first.RUNNING
    try:
        while status == depth_first.RUNNING and not clock.over:
            begin = clock.seconds
            status = walker.run(slices.steps)
            slices.took(clock.seconds - begin)
            now = int(np.searchsorted(ends, walker.deepest, side="right")) - 1
            if now > reached:
                reached, best_seconds = now, clock.seconds
            if report is not None:
                best = sizes[reached] if reached >= 0 else None
                report(Progress(*sizes[min(reached + 1, len(sizes) - 1)], walker.deepest / len(order.cells), best,
                                clock.seconds, walker.steps))  # fmt: skip
    except KeyboardInterrupt:
        if reached < 0 or rows is not None:
            raise
    exhausted = status == depth_first.EXHAUSTED
    if reached < 0 or (rows is not None and status != depth_first.DONE):
        why = "no such map exists" if exhausted else f"not found within {clock.limit:g} s"
        size = f"{rows}x{cols}" if rows is not None else "of any size"
        got = f"; the largest was {sizes[reached][0]}x{sizes[reached][1]}" if reached >= 0 else ""
        raise SearchError(f"map {size} with {request.alphabet} letters and distance {request.h}: {why}{got}")
    return Found(walker.best(*sizes[reached]), best_seconds, exhausted, walker.steps)
