import tracemalloc

import numpy as np
import pytest
from brute_force import distance, least_distances, turned, windows
from hypothesis import given, settings
from hypothesis import strategies as st

from pattern_gen import Grid, default_pattern
from pattern_gen.catalogue import load_ready_pattern, ready_names
from pattern_gen.search import search_map
from pattern_gen.search_request import Request
from pattern_gen.verification import verify_map


@settings(max_examples=60, deadline=None)
@given(
    grid=st.sampled_from(list(Grid)),
    alphabet=st.integers(2, 30),
    shape=st.tuples(st.integers(3, 7), st.integers(3, 7)),
    seed=st.integers(0, 10_000),
    rotations=st.booleans(),
)
def test_distances_are_those_of_brute_force(grid, alphabet, shape, seed, rotations):
    symbols = np.random.default_rng(seed).integers(0, alphabet, shape).astype(np.uint8)
    result = verify_map(symbols, grid=grid, alphabet=alphabet, h=1, own_limit=1, rotations=rotations)
    between, own = least_distances(symbols, grid is Grid.HEXAGONAL, rotations)
    assert result.windows == (shape[0] - 2) * (shape[1] - 2)
    assert (99 if result.closest is None else result.closest.distance) == between
    assert (99 if result.own is None else result.own.distance) == own


def named_distance(symbols, hexagonal, pair):
    """Distance of the two places that a verification names, by brute force."""
    all_windows = windows(symbols, hexagonal)
    step = 2 * np.pi / (6 if hexagonal else 4)
    first = all_windows[(pair.first.row, pair.first.col)]
    second = all_windows[(pair.second.row, pair.second.col)]
    # the sense of rotation is the verifier's business: either sense may be meant
    return {distance(first, turned(second, sense * pair.second.rotation * step)) for sense in (1, -1)}


@pytest.mark.parametrize("grid", list(Grid))
@pytest.mark.parametrize("turn", [0, 1, 2, 3])
def test_planted_copy_at_distance_h_minus_1_is_found_and_named(grid, turn):
    hexagonal = grid is Grid.HEXAGONAL
    h = 3
    symbols = search_map(Request(alphabet=9, h=h, grid=grid), rows=9, cols=12, time_limit=60.0).symbols.copy()
    # copy the window at (2, 2) over the one at (6, 8), turned, with h - 1 cells changed
    step = 2 * np.pi / (6 if hexagonal else 4)
    source = windows(symbols, hexagonal)[(2, 2)]
    target = turned(source, turn * step)
    row, col = 6, 8
    x0, y0 = (col * np.sqrt(3) / 2, row + 0.5 * (col % 2)) if hexagonal else (col, row)
    changed = 0
    for (x, y), value in target.items():
        c = round((x0 + x) / (np.sqrt(3) / 2)) if hexagonal else round(x0 + x)
        r = round(y0 + y - (0.5 * (c % 2) if hexagonal else 0.0))
        if changed < h - 1:
            value = (value + 1) % 9
            changed += 1
        symbols[r, c] = value
    result = verify_map(symbols, grid=grid, alphabet=9, h=h, own_limit=1)
    assert result.problem is not None
    assert result.closest.distance <= h - 1
    assert result.closest.distance in named_distance(symbols, hexagonal, result.closest)
    assert "row" in result.problem


@settings(max_examples=40, deadline=None)
@given(row=st.integers(0, 13), col=st.integers(0, 15), value=st.integers(0, 5))
def test_corrupted_cell_is_refused_exactly_when_it_breaks_the_distance(row, col, value):
    symbols = default_pattern().symbols[:14, :16].copy()
    symbols[row, col] = value
    result = verify_map(symbols, grid=Grid.SQUARE, alphabet=6, h=3, own_limit=1)
    codes = np.lib.stride_tricks.sliding_window_view(symbols, (3, 3)).reshape(-1, 3, 3)
    gaps = np.stack([(codes[:, None] != np.rot90(codes, k, (1, 2))[None]).sum(axis=(2, 3)) for k in range(4)])
    between = gaps[:, ~np.eye(len(codes), dtype=bool)].min()
    own = min(np.diag(gaps[k]).min() for k in (1, 2, 3))
    assert result.closest.distance == between
    assert result.own.distance == own
    assert (result.problem is None) == (between >= 3 and own >= 1)
    assert between in named_distance(symbols, False, result.closest)


def test_self_symmetric_window_is_named():
    symbols = np.array([[0, 1, 0, 2], [1, 2, 1, 0], [0, 1, 0, 0]], np.uint8)
    result = verify_map(symbols, grid=Grid.SQUARE, alphabet=3, h=1, own_limit=1)
    assert result.own.distance == 0
    assert "itself" in result.problem
    assert "row 1, column 1" in result.problem


@pytest.mark.parametrize("name", ready_names())
def test_ready_maps_hold(name):
    pattern = load_ready_pattern(name)
    result = verify_map(
        pattern.symbols,
        grid=pattern.grid,
        alphabet=pattern.alphabet,
        h=pattern.min_hamming,
        own_limit=0 if name.endswith("base") else 1,
        window=pattern.window,
    )
    assert result.problem is None
    kind, size, *_ = name.split("_")
    assert kind == pattern.grid.value
    assert size == f"{pattern.rows}x{pattern.cols}"


@pytest.mark.parametrize("grid", list(Grid))
def test_a_million_windows_need_less_than_200_mb(grid):
    symbols = np.random.default_rng(0).integers(0, 14, (602, 602)).astype(np.uint8)
    tracemalloc.start()
    result = verify_map(symbols, grid=grid, alphabet=14, h=1, own_limit=1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert result.windows == 360_000
    assert peak < 200 * result.windows
