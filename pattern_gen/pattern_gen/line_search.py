"""Search line by line: each line is drawn whole, from all its fillings at once (square grid, 3x3 windows, h >= 2).

Over two finished lines, the fillings of the next are the paths through a graph of columns whose states are pairs of
letters: an edge is a triple of letters that keeps its window apart from all finished ones (`near_lines`). The weights
of all paths are summed from the right (a partition function), so that whole lines are drawn without dead ends; only
windows of the same line may still be too close to each other, which a short back-tracking settles. Of several lines
drawn, the one that leaves the next line the largest sum of paths is kept. Where a line has no path, some lines before
it are undone: k or more with probability 1/k, so that every depth is reached again.

A path weighs the product of its letters' weights, which fall from letter to letter: uneven letters crowd the codes
together, so their neighbourhoods overlap more and cover less (as in lexicodes) than those of evenly drawn letters.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pattern_gen.near_lines import Stored, free_triples, make_stored, pop_line, push_line
from pattern_gen.packing import fold, packing, popcount, random_below, random_state, random_unit
from pattern_gen.pattern import Grid
from pattern_gen.windows import window_geometry

LINE, DEEPEST, STEPS = 0, 1, 2  # indices into State.counters
MAX_ALPHABET = 9  # a^3 triples are judged at once
_DRAWS, _NODES = 20, 6  # attempts at a line; nodes of an attempt per cell


class Paths(NamedTuple):
    """All fillings of a line."""

    free: NDArray[np.uint64]  # (width - 2, words) triples of letters allowed from a column on
    ways: NDArray[np.float64]  # (width + 1, a, a) sum of paths from a column on, after two letters; scaled per column


class State(NamedTuple):
    """Everything the compiled search works on."""

    symbols: NDArray[np.uint8]  # (lines, width)
    best: NDArray[np.uint8]  # (lines, width) at the greatest number of lines so far
    stored: Stored
    here: Paths
    ahead: Paths
    weights: NDArray[np.float64]  # (a,) of the letters
    pack: NDArray[np.uint64]
    rotations: NDArray[np.int64]  # (turns, 9)
    counters: NDArray[np.int64]  # (3,)
    random: NDArray[np.uint64]  # (1,)


class Rules(NamedTuple):
    """What a map must satisfy, and how many drawn lines are compared."""

    h: int
    own: int
    candidates: int


@njit(cache=True)
def _sum_paths(state: State, h: int, line: int, paths: Paths) -> float:
    """Find all fillings of a line; the logarithm of their summed weights, minus infinity where there is none."""
    a, width = state.weights.shape[0], state.symbols.shape[1]
    bits = state.pack[0]
    for col in range(width - 2):
        top = np.uint64(0)
        for i in range(3):
            top |= np.uint64(state.symbols[line - 2, col + i]) << (np.uint64(i) * bits)
            top |= np.uint64(state.symbols[line - 1, col + i]) << (np.uint64(i + 3) * bits)
        state.counters[STEPS] += 1
        if not free_triples(state.stored, state.pack, h, top, paths.free[col]):
            return -np.inf
    paths.ways[width] = 1.0
    log = 0.0
    for col in range(width - 1, 1, -1):
        largest = 0.0
        for p in range(a):
            for q in range(a):
                total = 0.0
                first = (p * a + q) * a
                for x in range(a):
                    if (paths.free[col - 2, (first + x) >> 6] >> np.uint64((first + x) & 63)) & np.uint64(1):
                        total += state.weights[x] * paths.ways[col + 1, q, x]
                paths.ways[col, p, q] = total
                largest = max(largest, total)
        if largest == 0.0:
            return -np.inf
        paths.ways[col] /= largest
        log += np.log(largest)
    for p in range(a):
        for q in range(a):
            paths.ways[2, p, q] *= state.weights[p] * state.weights[q]
    return log + np.log(paths.ways[2].sum())


@njit(cache=True)
def _fits(state: State, rules: Rules, line: int, col: int) -> bool:
    """Encode the window that ends at (line, col + 2); True: apart from its rotations and from the line's windows."""
    turns, n = state.rotations.shape
    bits = state.pack[0]
    codes = state.stored.codes[line]
    for turn in range(turns):
        code = np.uint64(0)
        for i in range(n):
            j = state.rotations[turn, i]
            code |= np.uint64(state.symbols[line - 2 + j // 3, col + j % 3]) << (np.uint64(i) * bits)
        codes[col * turns + turn] = code
    plain = codes[col * turns]
    for turn in range(1, turns):
        if popcount(fold(plain ^ codes[col * turns + turn], state.pack)) < rules.own:
            return False
    for i in range(col * turns):  # noqa: SIM110 - compiled
        if popcount(fold(plain ^ codes[i], state.pack)) < rules.h:
            return False
    return True


@njit(cache=True)
def _choose(state: State, chances: NDArray[np.float64]) -> int:
    """An index, in proportion to the chances; -1: all are zero."""
    draw = random_unit(state.random) * chances.sum()
    chosen = -1
    for i in range(chances.shape[0]):
        if chances[i] > 0.0:
            chosen = i
            draw -= chances[i]
            if draw < 0.0:
                break
    return chosen


@njit(cache=True)
def _draw_line(state: State, rules: Rules, line: int) -> bool:
    """Draw a line in proportion to the weights of its fillings; False: its windows stayed too close to each other."""
    a, width = state.weights.shape[0], state.symbols.shape[1]
    row = state.symbols[line]
    untried = np.empty((width, a), np.bool_)
    chances = np.empty(a)
    for _ in range(_DRAWS):
        start = _choose(state, state.here.ways[2].copy().reshape(-1))
        row[0], row[1] = start // a, start % a
        col = 2
        untried[2] = True
        for _ in range(_NODES * width):
            first = (np.int64(row[col - 2]) * a + row[col - 1]) * a
            for x in range(a):
                free = (state.here.free[col - 2, (first + x) >> 6] >> np.uint64((first + x) & 63)) & np.uint64(1)
                useful = untried[col, x] and free != 0
                chances[x] = state.weights[x] * state.here.ways[col + 1, row[col - 1], x] if useful else 0.0
            letter = _choose(state, chances)
            if letter < 0:
                col -= 1
                if col < 2:
                    break
                continue
            untried[col, letter] = False
            row[col] = letter
            if _fits(state, rules, line, col - 2):
                col += 1
                if col == width:
                    return True
                untried[col] = True
    return False


@njit(cache=True)
def _fill_line(state: State, rules: Rules, line: int) -> bool:
    """Fill a line with the drawn one that leaves the next line most; False: it has no filling."""
    lines, width = state.symbols.shape
    if _sum_paths(state, rules.h, line, state.here) == -np.inf:
        return False
    if line + 1 == lines:
        return _draw_line(state, rules, line)
    best = -np.inf
    kept = np.empty(width, np.uint8)
    for _ in range(rules.candidates):
        if _draw_line(state, rules, line):
            push_line(state.stored, line)
            log = _sum_paths(state, rules.h, line + 1, state.ahead)
            pop_line(state.stored, line)
            if log > best:
                best = log
                kept[:] = state.symbols[line]
    if best == -np.inf:
        return False
    state.symbols[line] = kept
    for col in range(width - 2):
        _fits(state, rules, line, col)  # encodes its windows again
    return True


@njit(cache=True)
def search_lines(state: State, rules: Rules, steps: int) -> bool:
    """Go on for about `steps` steps (windows' look-ups); True: all lines are filled. Stops where a bucket overflows."""
    lines, width = state.symbols.shape
    count = state.counters
    end = count[STEPS] + steps
    while count[STEPS] < end and count[LINE] < lines:
        line = count[LINE]
        if line < 2:
            for col in range(width):
                state.symbols[line, col] = random_below(state.random, state.weights.shape[0])
            count[STEPS] += 1
            count[LINE] += 1
        elif _fill_line(state, rules, line):
            push_line(state.stored, line)
            count[LINE] += 1
            if count[LINE] > count[DEEPEST]:
                count[DEEPEST] = count[LINE]
                state.best[:] = state.symbols
        else:
            back = np.int64(min(1.0 / (1.0 - random_unit(state.random)), np.float64(line)))
            for undone in range(line - 1, max(line - back, 2) - 1, -1):
                pop_line(state.stored, undone)
            count[LINE] = line - back if line - back >= 2 else 0
        if state.stored.overflow[0]:
            return False
    return count[LINE] == lines


class LineSearch:
    """A search for a map of lines x width cells, filled line by line."""

    def __init__(
        self, lines: int, width: int, *, alphabet: int, h: int, own: int, turns: int, seed: int, falling: float,
        candidates: int,
    ) -> None:  # fmt: skip
        """`falling`: weight of a letter over the one before; `candidates`: lines compared; others as in Request."""
        self._sizes = (lines, width, alphabet, h, turns)
        self._rules = Rules(h, own, candidates)
        self._random = random_state(seed)
        self._weights = falling ** np.arange(alphabet, dtype=np.float64)
        self._spare = 1.5
        self._steps = 0
        self._restart()

    def _restart(self) -> None:
        lines, width, a, h, turns = self._sizes
        stored = make_stored(lines, width, a, h, turns, self._spare)
        here, ahead = (
            Paths(np.zeros((width - 2, len(stored.every)), np.uint64), np.zeros((width + 1, a, a))) for _ in range(2)
        )
        rotations = window_geometry(Grid.SQUARE).rotations[:turns]
        self.state = State(
            np.zeros((lines, width), np.uint8), np.zeros((lines, width), np.uint8), stored, here, ahead, self._weights,
            packing(a, 9), rotations, np.zeros(3, np.int64), self._random,
        )  # fmt: skip

    def run(self, steps: int) -> bool:
        """Go on for about `steps` steps; True: the map is found."""
        if self.state.stored.overflow[0]:  # uneven letters: start over with more room
            self._steps += int(self.state.counters[STEPS])
            self._spare *= 2.0
            self._restart()
        return bool(search_lines(self.state, self._rules, steps))

    @property
    def steps(self) -> int:
        """Steps taken."""
        return self._steps + int(self.state.counters[STEPS])

    @property
    def deepest(self) -> int:
        """Most lines that were filled."""
        return int(self.state.counters[DEEPEST])

    @property
    def symbols(self) -> NDArray[np.uint8]:
        """(lines, width) uint8: the map when it is found."""
        return self.state.symbols
