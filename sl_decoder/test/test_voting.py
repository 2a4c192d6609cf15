"""The paper's voting: weights 9 and 1, one wrong letter corrected."""

import numpy as np

from pattern_gen import default_pattern
from sl_decoder import windows
from sl_decoder.codebook import build_codebook
from sl_decoder.voting import elect, vote

BOOK = build_codebook(default_pattern())


def laid_out(rows: int, cols: int):
    v, u = (a.ravel().astype(np.int32) for a in np.mgrid[:rows, :cols])
    conflicts = np.zeros(len(u), np.bool_)
    return windows.lay_out(np.zeros(len(u), np.int32), u, v, conflicts, 1, 4)[:3]


def votes(letter: np.ndarray, rows: int, cols: int) -> np.ndarray:
    cell, at, width = laid_out(rows, cols)
    return vote(cell, at, width, letter, BOOK.lattice.window, 6, BOOK.codes)


def test_a_found_window_gives_nine_to_each_of_its_letters() -> None:
    letter = default_pattern().symbols[:3, :3].ravel().astype(np.int32)
    score = votes(letter, 3, 3)
    assert (score[np.arange(9), letter] == 9).all()
    assert score.sum() == 81


def test_a_window_with_one_wrong_letter_gives_one_to_the_right_letter() -> None:
    letter = default_pattern().symbols[:3, :3].ravel().astype(np.int32)
    right = letter[4]
    letter[4] = (right + 1) % 6
    score = votes(letter, 3, 3)
    assert score[4, right] == 1
    assert score.sum() == 1  # minimum distance 3: no other single change is a code


def test_every_single_error_of_a_patch_is_corrected() -> None:
    truth = default_pattern().symbols[10:17, 20:27].ravel().astype(np.int32)
    for i in range(len(truth)):
        letter = truth.copy()
        letter[i] = (letter[i] + 1 + i % 5) % 6
        assert (elect(votes(letter, 7, 7), letter) == truth).all()


def test_without_votes_letters_stay() -> None:
    letter = np.array([3, 1, 4, 1], np.int32)
    assert (elect(np.zeros((4, 6), np.int32), letter) == letter).all()
