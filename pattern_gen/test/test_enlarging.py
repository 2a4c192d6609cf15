import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_generation import holds

from pattern_gen import Grid, Pattern, enlarge, generate
from pattern_gen.errors import SearchError
from pattern_gen.search_request import Reading


@settings(max_examples=15)
@given(
    grid=st.sampled_from(Grid),
    method=st.sampled_from(["paper", "best"]),
    case=st.sampled_from([(4, 1), (8, 2), (12, 3)]),
    size=st.tuples(st.integers(3, 6), st.integers(3, 6)),
    more=st.tuples(st.integers(0, 3), st.integers(0, 3)),
)
def test_the_map_is_the_top_left_part_of_the_larger_one(grid, method, case, size, more):
    letters, hamming = case
    small = generate(letters, hamming, grid=grid, rows=size[0], cols=size[1], cache=False)
    rows, cols = size[0] + more[0], size[1] + more[1]
    large = enlarge(small, rows=rows, cols=cols, method=method, cache=False)
    assert large.symbols.shape == (rows, cols)
    assert np.array_equal(large.symbols[: size[0], : size[1]], small.symbols)
    assert large.letters == small.letters
    assert large.grid is grid
    assert holds(large)


def test_without_a_size_it_grows_as_far_as_it_can_and_keeps_the_aspect():
    small = generate(4, 3, rows=5, cols=6, cache=False)
    large = enlarge(small, aspect=4 / 3, time_limit=1.0, cache=False)
    assert large.rows > 6
    assert large.cols / large.rows == pytest.approx(4 / 3, abs=0.2)
    assert np.array_equal(large.symbols[:5, :6], small.symbols)
    assert holds(large)


def test_a_map_that_breaks_the_rules_is_refused():
    small = generate(5, 3, rows=8, cols=8, cache=False)
    symbols = small.symbols.copy()
    symbols[5:8, 5:8] = symbols[:3, :3].T[::-1]  # a rotated copy of the first window
    broken = Pattern(Grid.SQUARE, symbols, small.letters, min_hamming=3)
    with pytest.raises(SearchError, match=r"breaks the rules itself.*row 1, column 1"):
        enlarge(broken, rows=10, cols=10, cache=False)
    symmetric = np.array([[0, 1, 0], [1, 2, 1], [0, 1, 0]], np.uint8)
    three = Pattern(Grid.SQUARE, symmetric, small.letters[:3])
    with pytest.raises(SearchError, match="breaks the rules itself"):
        enlarge(three, rows=5, cols=5, cache=False)
    assert enlarge(three, rows=5, cols=5, reading=Reading.BASE, cache=False).rows == 5


def test_smaller_sizes_are_refused():
    small = generate(5, 3, rows=8, cols=8, cache=False)
    with pytest.raises(SearchError, match="7x12 does not hold the map to enlarge, 8x8"):
        enlarge(small, rows=7, cols=12, cache=False)
