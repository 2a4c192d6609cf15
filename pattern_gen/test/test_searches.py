import time

import numpy as np
import pytest
from brute_force import least_distances
from hypothesis import given, settings
from hypothesis import strategies as st

from pattern_gen import Grid, generate
from pattern_gen.best import Repair, size_ladder
from pattern_gen.errors import SearchError
from pattern_gen.fill_order import growth_order, growth_sizes, raster_order
from pattern_gen.local_search import LocalSearch
from pattern_gen.search import search_map
from pattern_gen.search_request import Reading, Request, parse_aspect
from pattern_gen.verification import verify_map
from pattern_gen.windows import window_geometry


def check(symbols, request):
    result = verify_map(
        symbols,
        grid=request.grid,
        alphabet=request.alphabet,
        h=request.h,
        own_limit=request.own,
        window=request.window,
        rotations=request.invariant,
        band=request.band,
    )
    assert result.problem is None


@settings(max_examples=25, deadline=None)
@given(
    grid=st.sampled_from(list(Grid)),
    method=st.sampled_from(["paper", "best"]),
    reading=st.sampled_from(list(Reading)),
    invariant=st.booleans(),
    case=st.sampled_from([(3, 1), (5, 1), (36, 1), (4, 2), (9, 3), (16, 4), (30, 5)]),
    seed=st.integers(0, 99),
)
def test_found_maps_hold_what_was_asked_for_by_brute_force(grid, method, reading, invariant, case, seed):
    alphabet, h = case
    if h > 3:
        method = "best"  # chronological back-tracking does not get far at large distances
    request = Request(alphabet=alphabet, h=h, grid=grid, reading=reading, invariant=invariant, seed=seed)
    rows, cols = (5, 6) if h < 3 else (4, 4)
    symbols = search_map(request, rows=rows, cols=cols, method=method, time_limit=30.0).symbols
    between, own = least_distances(symbols, grid is Grid.HEXAGONAL, rotations=invariant)
    assert between >= h
    assert own >= (request.own if invariant else 0)
    assert symbols.max() < alphabet


@pytest.mark.parametrize("grid", list(Grid))
@pytest.mark.parametrize("h", [2, 3, 5])
def test_local_search_counts_conflicts_like_brute_force(grid, h):
    geometry = window_geometry(grid)
    symbols = np.random.default_rng(h).integers(0, 4, (9, 10)).astype(np.uint8)
    turns = grid.orientations
    search = LocalSearch(symbols, geometry=geometry, alphabet=4, h=h, own=1, turns=turns, seed=1)

    def conflicts(array):
        codes = array.reshape(-1)[geometry.cells(*array.shape)]
        count = 0
        for k in range(turns):
            gaps = (codes[:, None] != codes[None][..., geometry.rotations[k]]).sum(axis=2)
            count += int((gaps[np.triu_indices(len(codes), 1)] < h).sum())
            count += int((np.diag(gaps) < 1).sum()) if k else 0
        return count

    for _ in range(4):
        assert search.conflicts == conflicts(search.symbols)
        search.run(300, 0.5)


@pytest.mark.parametrize(("rows", "cols", "a", "h"), [(44, 58, 6, 3), (57, 76, 6, 3), (32, 43, 5, 3), (10, 13, 6, 5)])
def test_known_square_sizes_are_found(rows, cols, a, h):
    request = Request(alphabet=a, h=h)
    check(search_map(request, rows=rows, cols=cols, time_limit=60.0).symbols, request)


@pytest.mark.parametrize(("rows", "cols", "a", "h"), [(36, 55, 4, 1), (9, 14, 5, 3), (20, 31, 14, 3), (8, 12, 14, 5)])
def test_known_hexagonal_sizes_are_found(rows, cols, a, h):
    request = Request(alphabet=a, h=h, grid=Grid.HEXAGONAL)
    check(search_map(request, rows=rows, cols=cols, time_limit=60.0).symbols, request)


def test_all_binary_hexagons_fit_into_6x9_when_symmetric_ones_count():
    request = Request(alphabet=2, h=1, grid=Grid.HEXAGONAL, reading=Reading.BASE)
    check(search_map(request, rows=6, cols=9, time_limit=60.0).symbols, request)


def test_bounds_do_not_refuse_what_exists():
    """Own rotations may be closer than h in the STRICT reading: three windows fit where h-apart rotations allow two."""
    request = Request(alphabet=2, h=3, grid=Grid.HEXAGONAL)
    check(search_map(request, rows=3, cols=5, time_limit=60.0).symbols, request)


def test_the_papers_map_is_found_at_once():
    request = Request(alphabet=6, h=3)
    search_map(request, rows=5, cols=5)  # loads the machine code
    start = time.process_time()
    search_map(request, rows=44, cols=58)
    assert time.process_time() - start < 0.1


@pytest.mark.parametrize("method", ["paper", "best"])
def test_same_seed_same_map(method):
    maps = [search_map(Request(alphabet=5, h=3, seed=7), rows=14, cols=18, method=method).symbols for _ in range(2)]
    assert np.array_equal(*maps)
    if method == "best":
        other = search_map(Request(alphabet=5, h=3, seed=8), rows=14, cols=18).symbols
        assert not np.array_equal(maps[0], other)


def test_paper_search_starts_at_zero_and_ends_where_the_space_ends():
    found = search_map(Request(alphabet=2, h=3), method="paper", time_limit=120.0)
    assert found.exhausted
    assert found.size == (4, 5)  # the paper's table, marked exhausted there, too
    assert found.symbols[0, 0] == 0


def test_paper_search_is_the_smallest_number():
    """No smaller first window is possible: without rotations and h = 1 the map starts with all zeros."""
    found = search_map(Request(alphabet=3, h=1, invariant=False), rows=4, cols=4, method="paper")
    assert found.symbols.reshape(-1).tolist()[:11] == [0] * 11


@pytest.mark.parametrize("grid", list(Grid))
def test_orders_complete_every_window_once_with_its_last_cell(grid):
    geometry = window_geometry(grid)
    sizes = growth_sizes(3, 4 / 3, 80)
    for order, (rows, cols) in ((raster_order(geometry, 7, 9), (7, 9)), (growth_order(geometry, sizes), sizes[-1])):
        assert sorted(order.cells.tolist()) == list(range(rows * cols))
        cells = geometry.cells(rows, cols)
        rank = np.argsort(order.cells)
        assert sorted(order.windows.tolist()) == list(range(len(cells)))
        for step in range(rows * cols):
            for i in range(order.first[step], order.first[step + 1]):
                window = cells[order.windows[i]]
                assert rank[window].max() == step
                assert window[order.places[i]] == order.cells[step]


def test_growth_keeps_the_aspect():
    sizes = growth_sizes(3, 4 / 3, 3000)
    assert (44, 58) in sizes
    assert all(cols <= 4 / 3 * rows + 1e-9 for rows, cols in sizes)
    assert (59, 79) in size_ladder(3, 4 / 3, 6000)


def test_without_rotation_invariance_more_fits():
    request = Request(alphabet=3, h=3, invariant=False)
    symbols = search_map(request, rows=13, cols=17, time_limit=60.0).symbols
    check(symbols, request)
    between, _ = least_distances(symbols, False, rotations=False)
    assert between >= 3


def test_epipolar_band_compares_near_rows_only():
    request = Request(alphabet=3, h=3, invariant=False, band=2)
    symbols = search_map(request, rows=60, cols=16, time_limit=60.0).symbols
    check(symbols, request)
    unrestricted = verify_map(symbols, grid=Grid.SQUARE, alphabet=3, h=3, own_limit=0, rotations=False)
    assert unrestricted.problem is not None  # far rows do repeat: the restriction is what makes it possible


def test_larger_windows():
    request = Request(alphabet=2, h=3, window=5)
    check(search_map(request, rows=20, cols=26, time_limit=60.0).symbols, request)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"letters": 1}, "2 to 36"),
        ({"letters": 40}, "2 to 36"),
        ({"letters": 3, "hamming": 10}, "9 cells"),
        ({"letters": 3, "window": 4}, "odd"),
        ({"letters": 2, "hamming": 3, "rows": 20, "cols": 20}, "at most"),
        ({"letters": 3, "rows": 20}, "both rows and cols"),
        ({"letters": 3, "rows": 2, "cols": 9}, "holds no"),
        ({"letters": 3, "method": "magic"}, "magic"),
        ({"letters": 3, "hamming": 3, "rows": 13, "cols": 14, "time_limit": 0.3}, "not found within 0.3 s"),
    ],
)
def test_impossible_requests_say_why(options, words):
    with pytest.raises(SearchError, match=words):
        generate(options.pop("letters"), options.pop("hamming", 1), **options)


def test_small_impossible_size_is_proved_impossible():
    with pytest.raises(SearchError, match="no such map exists"):
        search_map(Request(alphabet=2, h=5), rows=3, cols=5, method="paper", time_limit=60.0)


def test_interruption_keeps_the_best():
    calls = 0

    def interrupt(progress):
        nonlocal calls
        calls += 1
        if progress.best is not None and calls > 3:
            raise KeyboardInterrupt

    found = search_map(Request(alphabet=6, h=3), report=interrupt, time_limit=60.0)
    check(found.symbols, Request(alphabet=6, h=3))


def test_generate_returns_a_pattern_that_fits_the_projector():
    pattern = generate(6, 3, rows=9, cols=12, projector=(640, 480), grid="hexagonal", reading="base")
    assert pattern.grid is Grid.HEXAGONAL
    assert (pattern.projector_width, pattern.projector_height) == (640, 480)


@pytest.mark.parametrize(("text", "value"), [("4:3", 4 / 3), ("1.5", 1.5)])
def test_aspect_is_read(text, value):
    assert parse_aspect(text) == pytest.approx(value)


@pytest.mark.parametrize("text", ["4:0", "x", "-1", "nan", ""])
def test_bad_aspect_is_refused(text):
    with pytest.raises(SearchError, match="aspect"):
        parse_aspect(text)


def test_repair_finds_what_it_says():
    request = Request(alphabet=8, h=5)
    repair = Repair(request, 8, 10, 3, 0.46)
    assert repair.run(1_000_000)
    check(repair.result(), request)
