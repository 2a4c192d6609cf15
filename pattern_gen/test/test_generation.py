import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pattern_gen import Grid, generate
from pattern_gen.errors import SearchError
from pattern_gen.search_request import Reading
from pattern_gen.verification import verify_map


def holds(pattern, *, reading=Reading.STRICT, rotations=True, band=None):
    h = pattern.min_hamming
    return (
        verify_map(
            pattern.symbols,
            grid=pattern.grid,
            alphabet=pattern.alphabet,
            h=h,
            own_limit=reading.own_distance(h) if rotations else 0,
            window=pattern.window,
            rotations=rotations,
            band=band,
        ).problem
        is None
    )


@given(
    grid=st.sampled_from(Grid), letters=st.integers(4, 8), reading=st.sampled_from(Reading), seed=st.integers(0, 99)
)  # fmt: skip
@settings(max_examples=20)
def test_small_maps_of_every_kind_hold(grid, letters, reading, seed):
    size = (9, 9) if grid is Grid.SQUARE else (6, 6)
    pattern = generate(
        letters, 3 if letters > 5 else 1, grid=grid, rows=size[0], cols=size[1], reading=reading, seed=seed
    )
    assert pattern.symbols.shape == size
    assert holds(pattern, reading=reading)


def test_the_pattern_of_the_paper_s_experiment():
    pattern = generate(6, 3, rows=44, cols=58, seed=1)
    assert holds(pattern)
    assert pattern.symbols.shape == (44, 58)


def test_the_same_seed_gives_the_same_map_and_another_another():
    first, again, other = (generate(6, 3, rows=20, cols=20, seed=s, cache=False).symbols for s in (5, 5, 6))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_the_paper_s_method_is_deterministic_and_starts_at_zero():
    first, again = (generate(5, 3, rows=10, cols=12, method="paper", cache=False).symbols for _ in range(2))
    assert np.array_equal(first, again)
    assert first[0, 0] == 0


@pytest.mark.parametrize(("letters", "hamming", "size"), [(2, 3, (4, 5)), (2, 5, (3, 4)), (3, 5, (4, 5))])
def test_the_paper_s_exhausted_cells_end_at_its_sizes(letters, hamming, size):
    pattern = generate(letters, hamming, method="paper", aspect=4 / 3, time_limit=60.0)
    assert pattern.symbols.shape == size
    assert holds(pattern)


def test_maps_without_rotation_invariance_may_be_larger_and_hold_in_one_orientation():
    pattern = generate(2, 1, rows=18, cols=18, invariant=False)
    assert holds(pattern, rotations=False)


def test_maps_with_the_epipolar_restriction_hold_within_the_band():
    pattern = generate(2, 1, rows=30, cols=40, band=3, invariant=False)
    assert holds(pattern, rotations=False, band=3)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"letters": 1, "rows": 5, "cols": 5}, "letter"),
        ({"letters": 6, "hamming": 10, "rows": 5, "cols": 5}, "a window has 9 cells; ask for 1 to 9"),
        ({"letters": 6, "window": 4, "rows": 5, "cols": 5}, "must be odd"),
        ({"letters": 2, "hamming": 3, "rows": 40, "cols": 40, "time_limit": 1.0}, "40x40"),
    ],
)
def test_impossible_requests_are_refused_with_the_numbers(arguments, reason):
    with pytest.raises((SearchError, ValueError), match=reason):
        generate(**arguments)
