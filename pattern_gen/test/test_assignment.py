from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pattern_gen import Grid, Letter, generate
from pattern_gen.assignment import assign_letters, best_assignment, confusion, separations
from pattern_gen.letters import choose_letters, default_letters
from pattern_gen.search_request import Request
from pattern_gen.windows import window_geometry


@pytest.mark.parametrize("grid", list(Grid))
def test_separations_are_those_of_brute_force(grid):
    request = Request(alphabet=4, h=1, grid=grid)
    symbols = np.random.default_rng(2).integers(0, 4, (7, 8)).astype(np.uint8)
    geometry = window_geometry(grid)
    codes = symbols.reshape(-1)[geometry.cells(7, 8)]
    pairs = [
        (codes[i], codes[j][turn])
        for i in range(len(codes))
        for j in range(len(codes))
        if i != j
        for turn in geometry.rotations
    ]
    least = min(int((a != b).sum()) for a, b in pairs)
    expected = np.zeros((4, 4))
    for a, b in pairs:
        if (a != b).sum() == least:
            for x, y in zip(a, b, strict=True):
                if x != y:
                    expected[x, y] += 1
    assert np.array_equal(separations(symbols, request), expected + expected.T)


def test_intensities_of_a_colour_are_confused_before_colours_and_shapes():
    probability = confusion(default_letters())
    assert np.array_equal(probability, probability.T)
    assert (np.diag(probability) == 0).all()
    likely = {tuple(sorted(pair)) for pair in np.argwhere(probability > 0.5 * probability.max()).tolist()}
    assert likely == {(0, 3), (1, 4), (2, 5)}
    red = (255, 0, 0)
    shapes = confusion([Letter(red), Letter(red, "square"), Letter(red, "ring"), Letter((250, 0, 0))])
    assert shapes[0, 3] > max(shapes[0, 1], shapes[0, 2]) > 0


@given(
    st.integers(2, 6).flatmap(
        lambda a: st.tuples(*(st.lists(st.floats(0, 10), min_size=a * a, max_size=a * a) for _ in range(2)))
    )
)
def test_the_assignment_is_the_best_of_all(values):
    a = int(len(values[0]) ** 0.5)
    counts, probability = (np.reshape(value, (a, a)) + np.reshape(value, (a, a)).T for value in values)

    def cost(order):
        return (probability[np.ix_(order, order)] * counts).sum()

    found = best_assignment(counts, probability)
    assert sorted(found) == list(range(a))
    assert cost(found) <= min(cost(order) for order in permutations(range(a))) * (1 + 1e-9) + 1e-12


def test_more_letters_are_assigned_no_worse_than_as_they_come():
    letters = choose_letters(20)
    random = np.random.default_rng(1)
    counts = random.random((20, 20))
    counts += counts.T
    probability = confusion(letters)
    order = best_assignment(counts, probability)
    assert sorted(order) == list(range(20))
    assert (probability[np.ix_(order, order)] * counts).sum() < 0.95 * (probability * counts).sum()


def test_pairs_that_separate_close_windows_get_representations_that_look_different():
    """The only windows at the least distance differ in the letters 0 and 3: these must not be red twice."""
    symbols = generate(6, 3, rows=12, cols=14, seed=3, cache=False).symbols
    request = Request(alphabet=6, h=3)
    letters = assign_letters(symbols, default_letters(), request)
    assert sorted(map(str, letters)) == sorted(map(str, default_letters()))
    counts, before, after = separations(symbols, request), confusion(default_letters()), confusion(letters)
    assert (counts * after).sum() <= (counts * before).sum()
    weighted = np.zeros((6, 6))
    weighted[0, 3] = weighted[3, 0] = 100.0
    order = best_assignment(weighted, before)
    assert before[order[0], order[3]] < 1e-3 * before.max()


def test_given_letters_are_kept_as_they_are():
    letters = default_letters()
    assert generate(letters, 3, rows=8, cols=9, cache=False).letters == letters
