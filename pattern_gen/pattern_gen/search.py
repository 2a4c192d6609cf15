"""Searches driven in slices, to report, stop and keep the best; growth as in section II.B, method "paper"."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pattern_gen import depth_first
from pattern_gen.errors import SearchError
from pattern_gen.fill_order import HEXAGONAL_ASPECT, growth_order, growth_sizes, growth_to
from pattern_gen.pattern import Grid
from pattern_gen.search_request import Clock, Found, Progress, Report, Request, most_windows
from pattern_gen.verification import verify_map
from pattern_gen.walker import Slices, Walker
from pattern_gen.windows import window_geometry

GROWTH_PATIENCE = 50_000  # steps without progress before a map being enlarged jumps back


def map_aspect(request: Request, image_aspect: float) -> float:
    """Columns over rows of a map that fills an image: hexagonal columns are closer together (section II.D)."""
    return image_aspect if request.grid is Grid.SQUARE else image_aspect * 0.75 * HEXAGONAL_ASPECT


def search_map(
    request: Request,
    *,
    rows: int | None = None,
    cols: int | None = None,
    aspect: float = 4 / 3,
    method: str = "best",
    time_limit: float = 10.0,
    processor_time: bool = False,
    start: NDArray[np.uint8] | None = None,
    report: Report | None = None,
) -> Found:
    """Search for a map of a given size, or for the largest one of an aspect ratio.

    Args:
        rows, cols: the size; both or neither.
        aspect: width over height of the image that the map fills, used without a size.
        method: "paper" or "best".
        time_limit: in [s].
        start: (rows, cols) a map to enlarge: the top left part of what is found.
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
    image_aspect = map_aspect(request, aspect)
    if start is not None:
        _check_start(request, start, rows, cols)
    if method == "paper" or start is not None:
        return _grow(request, rows, cols, image_aspect, clock, report, start=start, ascending=method == "paper")
    from pattern_gen.best import search_best

    return search_best(request, rows, cols, image_aspect, clock, report)


def _check_start(request: Request, start: NDArray[np.uint8], rows: int | None, cols: int | None) -> None:
    check = verify_map(
        start, grid=request.grid, alphabet=request.alphabet, h=request.h, own_limit=request.own,
        window=request.window, rotations=request.invariant, band=request.band,
    )  # fmt: skip
    if check.problem is not None:
        raise SearchError(f"the map to enlarge breaks the rules itself: {check.problem}")
    if rows is not None and cols is not None and (rows < start.shape[0] or cols < start.shape[1]):
        raise SearchError(
            f"{rows}x{cols} does not hold the map to enlarge, {start.shape[0]}x{start.shape[1]}; ask for more rows "
            "and columns"
        )


def _grow(
    request: Request,
    rows: int | None,
    cols: int | None,
    aspect: float,
    clock: Clock,
    report: Report | None,
    *,
    start: NDArray[np.uint8] | None,
    ascending: bool,
) -> Found:
    """Section II.B: growth by columns and rows from one window, or from a map to enlarge.

    Args:
        ascending: as written: lowest letter first, chronological back-tracking; else at random with back-jumping.
    """
    geometry = window_geometry(request.grid, request.window)
    start_size = None if start is None else (int(start.shape[0]), int(start.shape[1]))
    if rows is not None and cols is not None:
        sizes = growth_to(request.window, rows, cols, start_size)
    else:
        limit = 1_500_000 if request.h == 1 and request.band is None else 60_000
        limit = max(min(limit, 2 * most_windows(request) + 200), 0 if start is None else 2 * start.size)
        sizes = growth_sizes(request.window, aspect, limit, start_size)
    order = growth_order(geometry, sizes)
    patience, deviation, seed = (0, 0.0, 0) if ascending else (GROWTH_PATIENCE, 1.0, request.seed)
    walker = Walker(request, order, sizes[-1][1], patience=patience, deviation=deviation, seed=seed)
    if start is not None:
        canvas = np.zeros(sizes[-1], np.uint8)
        canvas[: start.shape[0], : start.shape[1]] = start
        walker.adopt(canvas.reshape(-1), start.size)
    return _follow_growth(request, walker, sizes, clock, report, exactly=rows is not None)


def _follow_growth(
    request: Request,
    walker: Walker,
    sizes: list[tuple[int, int]],
    clock: Clock,
    report: Report | None,
    *,
    exactly: bool,
) -> Found:
    """Run a growing search to its end; `exactly`: only the last size will do."""
    ends = np.array([rows * cols for rows, cols in sizes])
    slices = Slices()
    reached, best_seconds, interrupted = -1, 0.0, False
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
                part = walker.deepest / int(ends[-1])
                report(Progress(*sizes[min(reached + 1, len(sizes) - 1)], part, best, clock.seconds, walker.steps))
    except KeyboardInterrupt:
        interrupted = True
        if reached < 0 or exactly:
            raise
    exhausted = status == depth_first.EXHAUSTED
    if reached < 0 or (exactly and status != depth_first.DONE):
        why = "no such map exists" if exhausted else f"not found within {clock.limit:g} s"
        size = f"{sizes[-1][0]}x{sizes[-1][1]}" if exactly else "of any size"
        got = f"; the largest was {sizes[reached][0]}x{sizes[reached][1]}" if reached >= 0 else ""
        raise SearchError(f"map {size} with {request.alphabet} letters and distance {request.h}: {why}{got}")
    return Found(walker.best(*sizes[reached]), best_seconds, exhausted, walker.steps, interrupted)
