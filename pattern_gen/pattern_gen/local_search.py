"""Focused local search: repairs conflicts between windows until none is left.

A conflict is a pair of windows, and a rotation, whose codes differ in fewer than h cells. A step takes a random window
that has a conflict, a random cell of it, and draws the cell's letter from the heat bath: probability proportional to
exp(-conflicts / temperature). All letters of a cell are judged by one look-up per window that holds the cell: with the
cell itself masked out, a stored code at distance below h - 1 conflicts with every letter, one at exactly h - 1 with the
letter that it has there. The look-ups are in `repair_tables`.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pattern_gen.buckets import cell_classes, choose_keys, table_layout
from pattern_gen.packing import fold, packing, popcount, random_below, random_state, random_unit
from pattern_gen.repair_tables import MAX_CANDIDATES, State, Tables, insert, letter_at, near, remove
from pattern_gen.windows import WindowGeometry


@njit(cache=True)
def _count(state: State, window: int, change: int) -> None:
    """Add to a window's number of conflicts and keep the list of windows that have some."""
    before = state.conflicts[window]
    after = before + change
    state.conflicts[window] = after
    if before == 0 and after > 0:
        state.active_at[window] = state.counters[0]
        state.active[state.counters[0]] = window
        state.counters[0] += 1
    elif before > 0 and after == 0:
        state.counters[0] -= 1
        last = state.active[state.counters[0]]
        at = state.active_at[window]
        state.active[at] = last
        state.active_at[last] = at
        state.active_at[window] = -1


@njit(cache=True)
def build(state: State, tables: Tables, capacity: int, h: int, own: int) -> bool:
    """Fill codes, tables and conflicts from the symbols. False: a bucket overflowed."""
    cols = state.symbols.shape[1]
    turns, n = state.rotations.shape
    margin = 0
    for i in range(n):
        margin = max(margin, state.offsets[0, i, 1])
    bits = state.pack[0]
    width = cols - 2 * margin
    windows = state.conflicts.shape[0]
    tables.fill[:] = 0
    state.conflicts[:] = 0
    state.active_at[:] = -1
    state.local[:] = -1
    state.counters[0] = 0
    state.counters[1] = 0
    state.counters[3] = 0
    for w in range(windows):
        row, col = margin + w // width, margin + w % width
        for k in range(turns):
            code = np.uint64(0)
            for i in range(n):
                j = state.rotations[k, i]
                letter = state.symbols[row + state.offsets[col & 1, j, 0], col + state.offsets[col & 1, j, 1]]
                code |= np.uint64(letter) << (np.uint64(i) * bits)
            entry = w * turns + k
            state.codes[entry] = code
            for c in range(tables.weights.shape[0]):
                for t in range(tables.weights.shape[1]):
                    key = tables.starts[c, t]
                    for i in range(n):
                        key += tables.weights[c, t, i] * letter_at(code, i, bits)
                    if not insert(tables, c, t, entry, key, capacity):
                        return False
    place = state.place_of[0]
    for w in range(windows):
        state.local[w] = 0
        count = near(state, tables, capacity, h, w * turns, 0, 0, 0)
        state.local[w] = -1
        letter = letter_at(state.codes[w * turns], place, bits)
        for i in range(count):
            other = state.found[i, 1] // turns
            distance = state.found[i, 2] + (1 if state.found[i, 3] != letter else 0)
            if distance < h and other > w:
                _count(state, w, 1)
                _count(state, other, 1)
                state.counters[1] += 1
        for k in range(1, turns):
            if popcount(fold(state.codes[w * turns] ^ state.codes[w * turns + k], state.pack)) < own:
                _count(state, w, 1)
                state.counters[1] += 1
    return True


@njit(cache=True)
def _recolour(
    state: State,
    tables: Tables,
    capacity: int,
    alphabet: int,
    h: int,
    own: int,
    weights: NDArray[np.float64],
    row: int,
    col: int,
) -> bool:
    """Draw the letter of one cell from the heat bath. False: a bucket overflowed."""
    rows, cols = state.symbols.shape
    turns, n = state.rotations.shape
    bits = state.pack[0]
    margin = state.offsets[0, n - 1, 1]
    width = cols - 2 * margin
    last = weights.shape[0] - 1
    held = np.empty(n, np.int64)  # windows that hold the cell
    position = np.empty(n, np.int64)  # and where
    m = 0
    for i in range(n):
        centre_col = col - state.offsets[0, i, 1]
        centre_row = row - state.offsets[centre_col & 1, i, 0]
        if margin <= centre_row < rows - margin and margin <= centre_col < cols - margin:
            held[m] = (centre_row - margin) * width + centre_col - margin
            position[m] = i
            state.local[held[m]] = m
            m += 1
    cost = np.zeros(alphabet, np.int64)
    count = 0
    for k in range(m):
        p = position[k]
        begin = count
        count = near(state, tables, capacity, h, held[k] * turns + state.turn_of[p], state.class_of[p], k, count)
        for i in range(begin, count):
            if state.found[i, 2] == h - 1:
                cost[state.found[i, 3]] += 1
    inner = np.empty((n * n * turns, 4), np.int64)  # pairs among the windows that hold the cell: k, l, two letters
    inner_count = 0
    one = np.uint64(1)
    for k in range(m):
        code = state.codes[held[k] * turns]
        pa = position[k]
        for j in range(k, m):
            limit = own if j == k else h
            for turn in range(1 if j == k else 0, turns):
                other = state.codes[held[j] * turns + turn]
                pb = state.inverse[turn, position[j]]
                if pa == pb:
                    continue
                differ = fold(code ^ other, state.pack)
                differ &= ~((one << (np.uint64(pa) * bits)) | (one << (np.uint64(pb) * bits)))
                distance = popcount(differ)
                if distance >= limit or distance + 2 < limit:
                    continue
                first, second = letter_at(other, pa, bits), letter_at(code, pb, bits)
                if first == second:
                    cost[first] += 1
                elif distance + 1 < limit:
                    cost[first] += 1
                    cost[second] += 1
                else:
                    continue
                inner[inner_count, 0] = held[k]
                inner[inner_count, 1] = held[j]
                inner[inner_count, 2] = first
                inner[inner_count, 3] = second
                inner_count += 1
    least = cost.min()
    total = 0.0
    for x in range(alphabet):
        total += weights[min(cost[x] - least, last)]
    draw = random_unit(state.random) * total
    new = alphabet - 1
    for x in range(alphabet):
        draw -= weights[min(cost[x] - least, last)]
        if draw < 0.0:
            new = x
            break
    old = np.int64(state.symbols[row, col])
    done = True
    if new != old:
        for i in range(count):
            if state.found[i, 2] == h - 1 and (state.found[i, 3] == old or state.found[i, 3] == new):
                change = 1 if state.found[i, 3] == new else -1
                _count(state, held[state.found[i, 0]], change)
                _count(state, state.found[i, 1] // turns, change)
                state.counters[1] += change
        for i in range(inner_count):
            change = 0
            if inner[i, 2] == new or inner[i, 3] == new:
                change += 1
            if inner[i, 2] == old or inner[i, 3] == old:
                change -= 1
            if change != 0:
                _count(state, inner[i, 0], change)
                if inner[i, 0] != inner[i, 1]:
                    _count(state, inner[i, 1], change)
                state.counters[1] += change
        state.symbols[row, col] = new
        for k in range(m):
            for turn in range(turns):
                entry = held[k] * turns + turn
                at = state.inverse[turn, position[k]]
                state.codes[entry] ^= np.uint64(old ^ new) << (np.uint64(at) * bits)
                for c in range(tables.weights.shape[0]):
                    for t in range(tables.weights.shape[1]):
                        step = tables.weights[c, t, at] * (new - old)
                        if step != 0:
                            key = tables.keys[c, t, entry] + step
                            remove(tables, c, t, entry, capacity)
                            done = insert(tables, c, t, entry, key, capacity) and done
    for k in range(m):
        state.local[held[k]] = -1
    return done


@njit(cache=True)
def run(
    state: State,
    tables: Tables,
    capacity: int,
    alphabet: int,
    h: int,
    own: int,
    weights: NDArray[np.float64],
    steps: int,
) -> bool:
    """Take up to `steps` steps, fewer when no conflict is left. False: a bucket overflowed, build with more room."""
    cols = state.symbols.shape[1]
    n = state.rotations.shape[1]
    margin = state.offsets[0, n - 1, 1]
    width = cols - 2 * margin
    for _ in range(steps):
        if state.counters[0] == 0:
            return True
        w = state.active[random_below(state.random, state.counters[0])]
        i = random_below(state.random, n)
        col = margin + w % width
        row = margin + w // width + state.offsets[col & 1, i, 0]
        state.counters[2] += 1
        if not _recolour(state, tables, capacity, alphabet, h, own, weights, row, col + state.offsets[0, i, 1]):
            return False
    return True


class LocalSearch:
    """A map under repair.

    Attributes:
        symbols: (rows, cols) uint8, the present map.
    """

    def __init__(
        self,
        symbols: NDArray[np.uint8],
        *,
        geometry: WindowGeometry,
        alphabet: int,
        h: int,
        own: int,
        turns: int,
        seed: int,
    ) -> None:
        """`own`: least distance of a window from its own rotations (0: any); `turns`: rotations considered, 1: none."""
        self.geometry, self.alphabet, self.h, self.own = geometry, alphabet, h, own
        self._rotations = geometry.rotations[:turns]
        self._random = random_state(seed)
        self._spare = 1.0
        self._weights = np.ones(1)
        self._seen_temperature = -1.0
        self.steps = 0
        self._prepare(np.array(symbols, dtype=np.uint8))

    def _prepare(self, symbols: NDArray[np.uint8]) -> None:
        n, turns = self.geometry.size, len(self._rotations)
        margin = self.geometry.margin
        windows = (symbols.shape[0] - 2 * margin) * (symbols.shape[1] - 2 * margin)
        entries = windows * turns
        classes = cell_classes(self._rotations)
        keys = choose_keys(n - 1, self.alphabet, self.h, entries, len(classes.place_of), scan_cost=0.35)
        self.state = State(
            symbols, self.geometry.offsets, self._rotations,
            classes.inverse, classes.class_of, classes.turn_of, classes.place_of,
            packing(self.alphabet, n), np.zeros(entries, np.uint64), np.zeros(windows, np.int32),
            np.zeros(windows, np.int32), np.full(windows, -1, np.int32), np.zeros(4, np.int64), self._random,
            np.zeros((MAX_CANDIDATES, 4), np.int32), np.full(windows, -1, np.int32),
        )  # fmt: skip
        self.tables, self.capacity = self._make_tables(classes.place_of, keys, entries)
        while not build(self.state, self.tables, self.capacity, self.h, self.own):
            self._spare *= 2.0
            self.tables, self.capacity = self._make_tables(classes.place_of, keys, entries)

    def _make_tables(self, places: NDArray[np.int64], keys: list[tuple[int, ...]], entries: int) -> tuple[Tables, int]:
        weights, starts, buckets = table_layout(keys, places, self.geometry.size, self.alphabet)
        densest = max((entries / self.alphabet ** len(key) for key in keys), default=0.0)
        capacity = int(self._spare * (densest + 6.0 * np.sqrt(densest) + 8.0))
        shape = (len(places), len(keys), entries if keys else 0)
        return (
            Tables(weights, starts, np.zeros(buckets, np.int32), np.zeros(buckets * capacity, np.int32),
                   np.zeros(shape, np.int32), np.zeros(shape, np.int32)),
            capacity,
        )  # fmt: skip

    @property
    def symbols(self) -> NDArray[np.uint8]:
        """(rows, cols) uint8: the present map."""
        return self.state.symbols

    @property
    def conflicts(self) -> int:
        """Number of conflicting pairs of windows."""
        return int(self.state.counters[1])

    def run(self, steps: int, temperature: float) -> bool:
        """Take up to `steps` steps; True: no conflict is left."""
        if temperature != self._seen_temperature:
            self._weights = np.exp(-np.arange(40) / temperature)
            self._seen_temperature = temperature
        before = self.state.counters[2]
        if not run(self.state, self.tables, self.capacity, self.alphabet, self.h, self.own, self._weights, steps):
            self._spare *= 2.0
            self._prepare(self.state.symbols)
            before = 0
        self.steps += int(self.state.counters[2] - before)
        return self.conflicts == 0
