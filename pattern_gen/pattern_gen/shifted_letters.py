"""Maps in which the columns `shift` further right hold the next letters: M(row, col + shift) = M(row, col) + 1.

Letters count modulo the alphabet, so the codes form a set that adding one to all letters maps onto itself. That is
part of what makes linear codes dense, and one strip of `shift` columns decides the whole map: the search space is the
alphabet-th root of that of all maps, with nearly the same share of solutions. The strip is filled row by row,
depth-first, mostly the lowest letter first (as in lexicodes), with a new start after many steps without progress.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pattern_gen.packing import fold, packing, popcount, random_state
from pattern_gen.pattern import Grid
from pattern_gen.search_request import Request
from pattern_gen.search_rules import DEEPEST, DEPTH, ENTERING, SINCE, STEPS, fresh_counters, pick
from pattern_gen.windows import window_geometry

DEVIATION, PATIENCE = 0.05, 50_000  # see search_rules.Rules


class State(NamedTuple):
    """Everything the compiled search works on."""

    strip: NDArray[np.uint8]  # (rows, shift)
    untried: NDArray[np.uint64]  # (rows * shift,) by depth: letters, one bit each
    codes: NDArray[np.uint64]  # (windows of the strip, alphabet * turns) packed: all steps, all rotations
    pack: NDArray[np.uint64]
    rotations: NDArray[np.int64]  # (turns, n)
    counters: NDArray[np.int64]  # (6,)
    random: NDArray[np.uint64]  # (1,)


class Rules(NamedTuple):
    """What a map must satisfy."""

    window: int
    alphabet: int
    h: int
    own: int


@njit(cache=True)
def _fits(state: State, rules: Rules, top: int, left: int) -> bool:
    """Encode the window with this top left cell, in every step of its letters; True: apart from all before it."""
    turns, n = state.rotations.shape
    shift = state.strip.shape[1]
    index = top * shift + left
    own = state.codes[index]
    for step in range(rules.alphabet):
        for turn in range(turns):
            code = np.uint64(0)
            for i in range(n):
                j = state.rotations[turn, i]
                col = left + j % rules.window
                letter = state.strip[top + j // rules.window, col % shift] + col // shift + step
                code |= np.uint64(letter % rules.alphabet) << (np.uint64(i) * state.pack[0])
            own[step * turns + turn] = code
    plain = own[0]
    for i in range(1, own.shape[0]):
        if popcount(fold(plain ^ own[i], state.pack)) < (rules.own if i < turns else rules.h):
            return False
    before = state.codes[:index].reshape(-1)
    for i in range(before.shape[0]):  # noqa: SIM110 - compiled
        if popcount(fold(plain ^ before[i], state.pack)) < rules.h:
            return False
    return True


@njit(cache=True)
def _complete(state: State, rules: Rules, depth: int) -> bool:
    """Encode the windows that the cell completes; at a row's end also those that go on into the next letters."""
    shift = state.strip.shape[1]
    row, col = depth // shift, depth % shift
    top, left = row - rules.window + 1, max(col - rules.window + 1, 0)
    if top < 0 or (col < rules.window - 1 and col < shift - 1):
        return True
    last = shift - 1 if col == shift - 1 else left
    for at in range(left, last + 1):  # noqa: SIM110 - compiled
        if not _fits(state, rules, top, at):
            return False
    return True


@njit(cache=True)
def search_strip(state: State, rules: Rules, steps: int) -> bool:
    """Go on for up to `steps` steps; True: the strip is full."""
    count = state.counters
    one = np.uint64(1)
    cells = state.strip.reshape(-1)
    for _ in range(steps):
        depth = count[DEPTH]
        if depth == cells.shape[0]:
            break
        count[STEPS] += 1
        count[SINCE] += 1
        if count[SINCE] > PATIENCE:
            depth = 0
            count[SINCE] = 0
            count[ENTERING] = 1
        if count[ENTERING]:
            # adding a number to all letters makes no difference: the first cell is zero
            state.untried[depth] = one if depth == 0 else (one << np.uint64(rules.alphabet)) - one
        count[ENTERING] = 0
        if state.untried[depth] == 0:
            count[DEPTH] = max(depth - 1, 0)
            count[ENTERING] = depth == 0
            continue
        letter = pick(state.untried[depth], state.random, DEVIATION)
        state.untried[depth] &= ~(one << np.uint64(letter))
        cells[depth] = letter
        if _complete(state, rules, depth):
            depth += 1
            count[ENTERING] = 1
            if depth > count[DEEPEST]:
                count[DEEPEST] = depth
                count[SINCE] = 0
        count[DEPTH] = depth
    return count[DEPTH] == cells.shape[0]


class ShiftedLetters:
    """The search as one of the kinds of best.Searcher; for the square grid."""

    exhausted = False  # where there is no such map, there may be others
    turn_steps = 100_000

    def __init__(self, request: Request, rows: int, cols: int, *, downwards: bool = False) -> None:
        """The columns' windows are shared out evenly among the steps of the letters; `downwards`: the rows'."""
        alphabet, turns, window = request.alphabet, request.orientations, request.window
        self._downwards = downwards
        if downwards:  # a square map's mirror image is as good
            rows, cols = cols, rows
        shift = -(-(cols - window + 1) // alphabet)
        self._cols = cols
        self._rules = Rules(window, alphabet, request.h, request.own)
        self._state = State(
            np.zeros((rows, shift), np.uint8), np.zeros(rows * shift, np.uint64),
            np.zeros(((rows - window + 1) * shift, alphabet * turns), np.uint64), packing(alphabet, window**2),
            window_geometry(Grid.SQUARE, window).rotations[:turns], fresh_counters(), random_state(request.seed),
        )  # fmt: skip

    def run(self, steps: int) -> bool:
        """See best.Searcher."""
        return bool(search_strip(self._state, self._rules, steps))

    @property
    def filled(self) -> float:
        """Part of the strip that was filled at once."""
        return int(self._state.counters[DEEPEST]) / self._state.strip.size

    @property
    def steps(self) -> int:
        """Steps taken."""
        return int(self._state.counters[STEPS])

    def result(self) -> NDArray[np.uint8]:
        """(rows, cols) the map found."""
        shift, alphabet = self._state.strip.shape[1], self._rules.alphabet
        col = np.arange(self._cols)
        symbols = ((self._state.strip[:, col % shift] + col // shift) % alphabet).astype(np.uint8)
        return np.ascontiguousarray(symbols.T if self._downwards else symbols)
