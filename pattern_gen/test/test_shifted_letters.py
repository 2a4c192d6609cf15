import numpy as np
import pytest
from brute_force import least_distances

from pattern_gen.pattern import Grid
from pattern_gen.search import search_map
from pattern_gen.search_request import Reading, Request
from pattern_gen.shifted_letters import ShiftedLetters
from pattern_gen.verification import verify_map


@pytest.mark.parametrize("reading", list(Reading))
@pytest.mark.parametrize(
    ("alphabet", "h", "rows", "cols", "invariant"),
    [(3, 3, 8, 11, True), (8, 5, 9, 4, True), (5, 2, 6, 20, True), (4, 3, 9, 30, False), (7, 4, 6, 12, True)],
)
def test_its_maps_hold_by_brute_force(alphabet, h, rows, cols, invariant, reading):
    request = Request(alphabet=alphabet, h=h, reading=reading, invariant=invariant, seed=2)
    search = ShiftedLetters(request, rows, cols)
    assert search.run(1_000_000)
    symbols = search.result()
    assert symbols.shape == (rows, cols)
    assert symbols.max() < alphabet
    between, own = least_distances(symbols, False, rotations=invariant)
    assert between >= h
    assert own >= request.own


@pytest.mark.parametrize("downwards", [False, True])
def test_letters_go_up_by_one_every_shift(downwards):
    rows, cols = (11, 9) if downwards else (9, 11)
    search = ShiftedLetters(Request(alphabet=3, h=3, seed=1), rows, cols, downwards=downwards)
    assert search.run(1_000_000)
    symbols = search.result().astype(int)
    assert symbols.shape == (rows, cols)
    if downwards:
        symbols = symbols.T
    assert np.array_equal(symbols[:, 3:], (symbols[:, :-3] + 1) % 3)


def test_larger_windows():
    search = ShiftedLetters(Request(alphabet=2, h=5, window=5), 12, 13)
    assert search.run(1_000_000)
    between, _ = _least_by_pairs(search.result(), 5)
    assert between >= 5


def _least_by_pairs(symbols, window):
    """Least distances between and within windows of any size, over all quarter turns."""
    rows, cols = (side - window + 1 for side in symbols.shape)
    views = [symbols[r : r + window, c : c + window] for r in range(rows) for c in range(cols)]
    gaps = np.array([[[np.sum(one != np.rot90(two, k)) for two in views] for one in views] for k in range(4)])
    same = np.eye(len(views), dtype=bool)
    return gaps[:, ~same].min(), gaps[1:, same].min()


@pytest.mark.parametrize(("alphabet", "h", "rows", "cols"), [(3, 3, 11, 11), (8, 5, 18, 24)])
def test_sizes_that_no_other_search_reaches(alphabet, h, rows, cols):
    symbols = search_map(Request(alphabet=alphabet, h=h), rows=rows, cols=cols, time_limit=60.0).symbols
    assert verify_map(symbols, grid=Grid.SQUARE, alphabet=alphabet, h=h, own_limit=1).problem is None


def test_where_the_strip_has_no_filling_it_starts_over():
    search = ShiftedLetters(Request(alphabet=2, h=3), 9, 9)
    assert not search.run(60_000)
    assert search.steps == 60_000
    assert 0.0 < search.filled < 1.0
