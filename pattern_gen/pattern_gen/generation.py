"""Generation of patterns: a map is searched, letters are assigned to it, and it is fitted to the projector."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pattern_gen.pattern import Grid, Letter, Pattern, fit_to_projector
from pattern_gen.search_request import Reading, Report, Request


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
