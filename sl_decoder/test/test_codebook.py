"""The code table: every window in every orientation, found by binary search."""

import numpy as np
import pytest
from decoder_helpers import hexagonal_pattern
from hypothesis import given, settings
from hypothesis import strategies as st

from pattern_gen import default_pattern
from sl_common.errors import StructuredLightError
from sl_decoder.codebook import build_codebook, find_code, window_code
from sl_decoder.lattice import HEXAGONAL, SQUARE, from_axial, mirrored, to_axial

BOOK = build_codebook(default_pattern())


def test_all_windows_in_four_orientations() -> None:
    assert len(BOOK.codes) == 4 * 42 * 56
    assert (np.diff(BOOK.codes) > 0).all()


@settings(deadline=None, max_examples=50)
@given(row=st.integers(1, 42), col=st.integers(1, 56), turn=st.integers(0, 3))
def test_a_rotated_window_is_found_where_it_is(row: int, col: int, turn: int) -> None:
    symbols = default_pattern().symbols[row - 1 : row + 2, col - 1 : col + 2]
    seen = np.rot90(symbols, turn)
    ring = [(1, 2), (2, 2), (2, 1), (2, 0), (1, 0), (0, 0), (0, 1), (0, 2)]
    code = window_code(np.array([seen[1, 1], *[seen[r, c] for r, c in ring]]), 6)
    assert [(r, c) for r, c, _ in BOOK.lookup(code)] == [(row, col)]


def test_unknown_codes_are_not_found() -> None:
    codes = np.array([2, 5, 9], np.int64)
    assert [find_code(codes, c) for c in (1, 2, 3, 5, 9, 10)] == [-1, 0, -1, 1, 2, -1]
    assert find_code(np.zeros(0, np.int64), 3) == -1


@pytest.mark.parametrize("hexagonal", [False, True])
def test_axial_coordinates_round_trip_and_neighbours_are_equidistant(hexagonal: bool) -> None:
    row, col = (a.ravel() for a in np.mgrid[:9, :11])
    u, v = to_axial(row, col, hexagonal=hexagonal)
    back = from_axial(u, v, hexagonal=hexagonal)
    assert (back[0] == row).all()
    assert (back[1] == col).all()
    pattern = hexagonal_pattern() if hexagonal else default_pattern()
    lattice = HEXAGONAL if hexagonal else SQUARE
    place = {(int(a), int(b)): pattern.centers[r, c] for a, b, r, c in zip(u, v, row, col, strict=True)}
    at = to_axial(np.array(4), np.array(5), hexagonal=hexagonal)
    centre = place[(int(at[0]), int(at[1]))]
    around = np.array([place[(int(at[0] + du), int(at[1] + dv))] - centre for du, dv in lattice.steps])
    assert np.linalg.norm(around, axis=1) == pytest.approx([pattern.pitch] * lattice.directions)
    angle = np.unwrap(np.arctan2(around[:, 1], around[:, 0]))
    assert np.diff(angle) == pytest.approx([2 * np.pi / lattice.directions] * (lattice.directions - 1))


@pytest.mark.parametrize("lattice", [SQUARE, HEXAGONAL])
def test_a_full_turn_is_no_turn(lattice) -> None:
    for k in range(lattice.directions):
        product = lattice.turn[k] @ lattice.turn[(lattice.directions - k) % lattice.directions]
        assert (product == np.eye(2)).all()
        assert {tuple(lattice.turn[k] @ step) for step in lattice.steps} == {tuple(step) for step in lattice.steps}


@pytest.mark.parametrize("hexagonal", [False, True])
def test_a_mirror_of_a_mirror_is_the_original(hexagonal: bool) -> None:
    u, v = np.array([3, -2, 5]), np.array([1, 4, -7])
    once = mirrored(u, v, hexagonal=hexagonal)
    twice = mirrored(*once, hexagonal=hexagonal)
    assert (twice[0] == u).all()
    assert (twice[1] == v).all()
    assert not (once[0] == u).all()


def test_other_windows_are_refused() -> None:
    pattern = default_pattern()
    wide = type(pattern)(grid=pattern.grid, symbols=pattern.symbols, letters=pattern.letters, window=5)
    with pytest.raises(StructuredLightError, match="window=5"):
        build_codebook(wide)
