"""Depth-first search for maps with a Hamming distance, section II.B, with look-ups that judge all letters at once.

A step fills one cell, which completes at most a few windows. With that cell masked out, a stored code (of any rotation
of any window) at distance below h - 1 forbids every letter, one at exactly h - 1 forbids the letter that it has there.
Stored codes are found through buckets on some of the other cells, see `buckets`; the buckets are linked lists,
pushed and popped in the order of the search.

Letters are tried in ascending order (the paper: a number in base a that only increases) or in random order with
back-jumping: after `patience` steps without progress, half a row to three rows are undone and drawn again.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pattern_gen.buckets import cell_classes, choose_keys, table_layout
from pattern_gen.fill_order import FillOrder
from pattern_gen.packing import fold, packing, popcount, random_below, random_state
from pattern_gen.windows import WindowGeometry

RUNNING, DONE, EXHAUSTED = 0, 1, 2
DEPTH, DEEPEST, SINCE, STEPS, ENTERING = 0, 1, 2, 3, 4  # indices into State.counters


class State(NamedTuple):
    """Everything the compiled search works on."""

    symbols: NDArray[np.uint8]  # (rows * cols,)
    best: NDArray[np.uint8]  # (rows * cols,) symbols of the largest whole map so far
    free: NDArray[np.uint64]  # (rows * cols,) by depth: letters not yet tried, one bit each
    codes: NDArray[np.uint64]  # (windows * k,)
    offsets: NDArray[np.int64]  # (2, n, 2)
    rotations: NDArray[np.int64]  # (k, n)
    inverse: NDArray[np.int64]  # (k, n)
    class_of: NDArray[np.int64]  # (n,)
    turn_of: NDArray[np.int64]  # (n,)
    place_of: NDArray[np.int64]  # (classes,)
    pack: NDArray[np.uint64]  # (5,)
    weights: NDArray[np.int64]  # (classes, tables, n)
    starts: NDArray[np.int64]  # (classes, tables)
    heads: NDArray[np.int32]  # (buckets,) newest entry, -1: none
    nexts: NDArray[np.int32]  # (classes, tables, entries) the entry before
    counters: NDArray[np.int64]  # (5,)
    random: NDArray[np.uint64]  # (1,)


class Rules(NamedTuple):
    """What a map must satisfy, and how the search goes about it."""

    cols: int
    alphabet: int
    h: int
    own: int  # least distance of a window from its own rotations, 0: any
    band: int  # windows more than this many rows apart may be equal; -1: none may
    patience: int  # steps without progress before a back-jump; 0: never, letters in ascending order


@njit(cache=True, inline="always")
def _key(state: State, table_class: int, table: int, code: np.uint64) -> int:
    bits = state.pack[0]
    field = (np.uint64(1) << bits) - np.uint64(1)
    key = state.starts[table_class, table]
    for i in range(state.weights.shape[2]):
        weight = state.weights[table_class, table, i]
        if weight != 0:
            key += weight * np.int64((code >> (np.uint64(i) * bits)) & field)
    return key


@njit(cache=True)
def _encode(state: State, rules: Rules, window: int, turn: int) -> np.uint64:
    margin = state.offsets[0, -1, 1]
    width = rules.cols - 2 * margin
    row, col = margin + window // width, margin + window % width
    code = np.uint64(0)
    bits = state.pack[0]
    for i in range(state.rotations.shape[1]):
        j = state.rotations[turn, i]
        cell = (row + state.offsets[col & 1, j, 0]) * rules.cols + col + state.offsets[col & 1, j, 1]
        code |= np.uint64(state.symbols[cell]) << (np.uint64(i) * bits)
    return code


@njit(cache=True)
def _allowed(state: State, rules: Rules, window: int, place: int) -> np.uint64:
    """Letters for the cell at `place` that keep the window apart from all stored ones and from its own rotations."""
    bits = state.pack[0]
    one = np.uint64(1)
    field = (one << bits) - one
    turns = state.rotations.shape[0]
    every = (one << np.uint64(rules.alphabet)) - one
    allowed = every
    plain = _encode(state, rules, window, 0)
    for turn in range(1, turns):
        turned = _encode(state, rules, window, turn)
        at = state.inverse[turn, place]
        differ = fold(plain ^ turned, state.pack)
        if at == place:
            if popcount(differ) < rules.own:
                return np.uint64(0)
            continue
        differ &= ~((one << (np.uint64(place) * bits)) | (one << (np.uint64(at) * bits)))
        distance = popcount(differ)
        if distance >= rules.own:
            continue
        first = (turned >> (np.uint64(place) * bits)) & field
        second = (plain >> (np.uint64(at) * bits)) & field
        if distance + 2 < rules.own:
            return np.uint64(0)
        if distance + 1 < rules.own or first == second:
            allowed &= ~((one << first) | (one << second))
    table_class = state.class_of[place]
    query = _encode(state, rules, window, state.turn_of[place])
    at_place = np.uint64(state.place_of[table_class]) * bits
    mask = ~(one << at_place)
    width = rules.cols - 2 * state.offsets[0, -1, 1]
    row = window // width
    for table in range(state.weights.shape[1]):
        entry = state.heads[_key(state, table_class, table, query)]
        while entry >= 0:
            code = state.codes[entry]
            distance = popcount(fold(code ^ query, state.pack) & mask)
            if distance < rules.h:
                if rules.band >= 0 and abs(entry // turns // width - row) > rules.band:
                    pass
                elif distance < rules.h - 1:
                    return np.uint64(0)
                else:
                    allowed &= ~(one << ((code >> at_place) & field))
                    if allowed == 0:
                        return allowed
            entry = state.nexts[table_class, table, entry]
    return allowed


@njit(cache=True)
def _push(state: State, rules: Rules, window: int) -> None:
    turns = state.rotations.shape[0]
    for turn in range(turns):
        entry = window * turns + turn
        code = _encode(state, rules, window, turn)
        state.codes[entry] = code
        for table_class in range(state.weights.shape[0]):
            for table in range(state.weights.shape[1]):
                key = _key(state, table_class, table, code)
                state.nexts[table_class, table, entry] = state.heads[key]
                state.heads[key] = entry


@njit(cache=True)
def _pop(state: State, window: int) -> None:
    turns = state.rotations.shape[0]
    for turn in range(turns - 1, -1, -1):
        entry = window * turns + turn
        code = state.codes[entry]
        for table_class in range(state.weights.shape[0]):
            for table in range(state.weights.shape[1]):
                state.heads[_key(state, table_class, table, code)] = state.nexts[table_class, table, entry]


@njit(cache=True, inline="always")
def pick(free: np.uint64, random: NDArray[np.uint64], ascending: bool) -> int:
    """A letter out of the free ones: the lowest, or a random one."""
    skip = 0 if ascending else random_below(random, popcount(free))
    for _ in range(skip):
        free &= free - np.uint64(1)
    return popcount((free & (~free + np.uint64(1))) - np.uint64(1))


@njit(cache=True)
def _undo(state: State, order: FillOrder, depth: int) -> None:
    for i in range(order.first[depth + 1] - 1, order.first[depth] - 1, -1):
        _pop(state, order.windows[i])


@njit(cache=True)
def search(state: State, order: FillOrder, rules: Rules, steps: int) -> int:
    """Go on for up to `steps` steps. Returns RUNNING, DONE (all cells filled) or EXHAUSTED (no such map exists)."""
    total = order.cells.shape[0]
    count = state.counters
    one = np.uint64(1)
    every = (one << np.uint64(rules.alphabet)) - one
    for _ in range(steps):
        depth = count[DEPTH]
        if depth == total:
            return DONE
        count[STEPS] += 1
        count[SINCE] += 1
        begin, end = order.first[depth], order.first[depth + 1]
        cell = order.cells[depth]
        if count[ENTERING]:
            state.symbols[cell] = 0
            # which letter is which is arbitrary: the first cell is zero
            state.free[depth] = one if depth == 0 else every
            if end > begin:
                state.free[depth] = _allowed(state, rules, order.windows[begin], order.places[begin])
            count[ENTERING] = 0
        if rules.patience > 0 and count[SINCE] > rules.patience and depth > 0:
            jump = rules.cols // 2 + random_below(state.random, 3 * rules.cols) + 1
            for back in range(depth - 1, max(depth - jump, 0) - 1, -1):
                _undo(state, order, back)
            count[DEPTH] = max(depth - jump, 0)
            count[SINCE] = 0
            count[ENTERING] = 1
            continue
        if state.free[depth] == 0:
            if depth == 0:
                return EXHAUSTED
            _undo(state, order, depth - 1)
            count[DEPTH] = depth - 1
            continue
        letter = pick(state.free[depth], state.random, rules.patience == 0)
        state.free[depth] &= ~(one << np.uint64(letter))
        placed = begin
        while placed < end:
            if placed > begin:  # the first window's letters were judged above
                state.symbols[cell] = 0
                if not (_allowed(state, rules, order.windows[placed], order.places[placed]) >> np.uint64(letter)) & one:
                    break
            state.symbols[cell] = letter
            _push(state, rules, order.windows[placed])
            placed += 1
        if placed < end:
            for i in range(placed - 1, begin - 1, -1):
                _pop(state, order.windows[i])
            continue
        state.symbols[cell] = letter
        count[DEPTH] = depth + 1
        count[ENTERING] = 1
        if depth + 1 > count[DEEPEST]:
            count[DEEPEST] = depth + 1
            count[SINCE] = 0
            if order.whole[depth]:
                state.best[:] = state.symbols
    return DONE if count[DEPTH] == total else RUNNING


def prepare(order: FillOrder, rules: Rules, *, geometry: WindowGeometry, turns: int, seed: int) -> State:
    """The empty state of a search.

    Args:
        turns: rotations considered, 1: none.
    """
    rotations = geometry.rotations[:turns]
    n, cells, windows = geometry.size, len(order.cells), len(order.windows)
    classes = cell_classes(rotations, np.unique(order.places).astype(np.int64))
    # the whole map's codes stand in the tables only at the end: count half of them
    keys = choose_keys(n - 1, rules.alphabet, rules.h, windows * turns // 2 + 1, len(classes.place_of), scan_cost=1.0)
    if not keys:
        keys = [()]  # one list of all codes
    weights, starts, buckets = table_layout(keys, classes.place_of, n, rules.alphabet)
    return State(
        np.zeros(cells, np.uint8), np.zeros(cells, np.uint8), np.zeros(cells, np.uint64),
        np.zeros(windows * turns, np.uint64), geometry.offsets, rotations, classes.inverse, classes.class_of,
        classes.turn_of, classes.place_of, packing(rules.alphabet, n), weights, starts,
        np.full(buckets, -1, np.int32), np.full((*starts.shape, windows * turns), -1, np.int32),
        np.array([0, 0, 0, 0, 1], np.int64), random_state(seed),
    )  # fmt: skip
