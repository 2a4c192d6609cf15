"""Depth-first search for h = 1: every code is used once. One bit per code, or a hash set where that would be too large.

Codes are numbers in base a with the cell that is filled last as the lowest digit, so the bits of all letters of a cell
lie side by side. The codes of all rotations of each window are stored: one look-up judges a letter.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pattern_gen.depth_first import DEEPEST, DEPTH, DONE, ENTERING, EXHAUSTED, RUNNING, SINCE, STEPS, Rules, pick
from pattern_gen.errors import SearchError
from pattern_gen.fill_order import FillOrder
from pattern_gen.packing import popcount, random_below, random_state
from pattern_gen.windows import WindowGeometry

MAX_BITS = 2**30  # of the table: 128 MB
_EMPTY = -1


class State(NamedTuple):
    """Everything the compiled search works on."""

    symbols: NDArray[np.uint8]  # (rows * cols,)
    best: NDArray[np.uint8]  # (rows * cols,) symbols of the largest whole map so far
    free: NDArray[np.uint64]  # (rows * cols,) by depth: letters not yet tried
    offsets: NDArray[np.int64]  # (2, n, 2)
    rotations: NDArray[np.int64]  # (k, n)
    inverse: NDArray[np.int64]  # (k, n)
    powers: NDArray[np.int64]  # (n,) value of each position of a code
    bits: NDArray[np.uint64]  # one bit a code; empty: the hash set is used
    hashed: NDArray[np.int64]  # open addressing, -1: empty
    counters: NDArray[np.int64]  # (5,) as in depth_first
    random: NDArray[np.uint64]  # (1,)


@njit(cache=True, inline="always")
def _slot(state: State, code: int) -> Any:
    """Slot of a code in the hash set, or the empty slot where it belongs."""
    mask = np.int64(state.hashed.shape[0] - 1)
    slot = np.int64((np.uint64(code) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(20)) & mask
    while state.hashed[slot] != _EMPTY and state.hashed[slot] != code:
        slot = (slot + 1) & mask
    return slot


@njit(cache=True, inline="always")
def _has(state: State, code: int) -> bool:
    if state.bits.shape[0] > 0:
        return (state.bits[code >> 6] >> np.uint64(code & 63)) & np.uint64(1) != 0
    return state.hashed[_slot(state, code)] == code


@njit(cache=True, inline="always")
def _set(state: State, code: int, present: bool) -> None:
    """Add or take out a code; taken out in reverse order, so the hash set needs no tombstones."""
    if state.bits.shape[0] > 0:
        if present:
            state.bits[code >> 6] |= np.uint64(1) << np.uint64(code & 63)
        else:
            state.bits[code >> 6] &= ~(np.uint64(1) << np.uint64(code & 63))
    else:
        state.hashed[_slot(state, code)] = code if present else _EMPTY


@njit(cache=True, inline="always")
def _encode(state: State, cols: int, window: int, turn: int) -> int:
    margin = state.offsets[0, -1, 1]
    width = cols - 2 * margin
    row, col = margin + window // width, margin + window % width
    code = 0
    for i in range(state.rotations.shape[1]):
        j = state.rotations[turn, i]
        cell = (row + state.offsets[col & 1, j, 0]) * cols + col + state.offsets[col & 1, j, 1]
        code += np.int64(state.symbols[cell]) * state.powers[i]
    return code


@njit(cache=True)
def _allowed(state: State, rules: Rules, window: int, place: int) -> np.uint64:
    """Letters for the cell at `place` (now 0) whose code is new and, if asked for, differs from its own rotations."""
    one = np.uint64(1)
    code = _encode(state, rules.cols, window, 0)
    allowed = np.uint64(0)
    for letter in range(rules.alphabet):
        if not _has(state, code + letter * state.powers[place]):
            allowed |= one << np.uint64(letter)
    if rules.own > 0 and allowed != 0:
        for turn in range(1, state.rotations.shape[0]):
            turned = _encode(state, rules.cols, window, turn)
            at = state.inverse[turn, place]
            # code + letter * powers[place] == turned + letter * powers[at] for which letter?
            step = state.powers[at] - state.powers[place]
            if step == 0:
                if code == turned:
                    return np.uint64(0)
            elif (code - turned) % step == 0:
                letter = (code - turned) // step
                if 0 <= letter < rules.alphabet:
                    allowed &= ~(one << np.uint64(letter))
    return allowed


@njit(cache=True)
def _pick_balanced(state: State, order: FillOrder, rules: Rules, depth: int) -> int:
    """The free letter that leaves the next cell the most free letters; ties at random.

    Contexts then run out of letters evenly: nearly all of them keep a free one until nearly all codes are used.
    """
    free = state.free[depth]
    begin, end = order.first[depth + 1], order.first[depth + 2] if depth + 2 < order.first.shape[0] else 0
    if end <= begin or popcount(free) == 1:
        return pick(free, state.random, False)
    cell, next_cell = order.cells[depth], order.cells[depth + 1]
    place = order.places[begin]
    state.symbols[cell] = 0
    state.symbols[next_cell] = 0
    code = _encode(state, rules.cols, order.windows[begin], 0)
    best, best_left, ties = 0, -1, 0
    for letter in range(rules.alphabet):
        if (free >> np.uint64(letter)) & np.uint64(1):
            left = 0
            base = code + letter * state.powers[place - 1]
            for other in range(rules.alphabet):
                if not _has(state, base + other * state.powers[place]):
                    left += 1
            if left > best_left:
                best, best_left, ties = letter, left, 1
            elif left == best_left:
                ties += 1
                if random_below(state.random, ties) == 0:
                    best = letter
    return best


@njit(cache=True)
def _store(state: State, cols: int, window: int, present: bool) -> None:
    turns = state.rotations.shape[0]
    for i in range(turns):
        turn = i if present else turns - 1 - i
        code = _encode(state, cols, window, turn)
        if _has(state, code) != present:  # a code that equals its own rotation is stored once
            _set(state, code, present)


@njit(cache=True)
def _undo(state: State, order: FillOrder, cols: int, depth: int) -> None:
    for i in range(order.first[depth + 1] - 1, order.first[depth] - 1, -1):
        _store(state, cols, order.windows[i], False)


@njit(cache=True)
def search_unique(state: State, order: FillOrder, rules: Rules, steps: int) -> int:
    """Go on for up to `steps` steps, as depth_first.search does."""
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
            state.free[depth] = one if depth == 0 else every
            if end > begin:
                state.free[depth] = _allowed(state, rules, order.windows[begin], order.places[begin])
            count[ENTERING] = 0
        if rules.patience > 0 and count[SINCE] > rules.patience and depth > 0:
            jump = rules.cols // 2 + random_below(state.random, 3 * rules.cols) + 1
            for back in range(depth - 1, max(depth - jump, 0) - 1, -1):
                _undo(state, order, rules.cols, back)
            count[DEPTH] = max(depth - jump, 0)
            count[SINCE] = 0
            count[ENTERING] = 1
            continue
        if state.free[depth] == 0:
            if depth == 0:
                return EXHAUSTED
            _undo(state, order, rules.cols, depth - 1)
            count[DEPTH] = depth - 1
            continue
        if rules.patience > 0:
            letter = _pick_balanced(state, order, rules, depth)
        else:
            letter = pick(state.free[depth], state.random, True)
        state.free[depth] &= ~(one << np.uint64(letter))
        placed = begin
        while placed < end:
            if placed > begin:
                state.symbols[cell] = 0
                if not (_allowed(state, rules, order.windows[placed], order.places[placed]) >> np.uint64(letter)) & one:
                    break
            state.symbols[cell] = letter
            _store(state, rules.cols, order.windows[placed], True)
            placed += 1
        if placed < end:
            state.symbols[cell] = letter
            for i in range(placed - 1, begin - 1, -1):
                _store(state, rules.cols, order.windows[i], False)
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


def prepare_unique(order: FillOrder, rules: Rules, *, geometry: WindowGeometry, turns: int, seed: int) -> State:
    """The empty state of a search; `turns`: rotations considered, 1: none.

    Raises:
        SearchError: a code does not fit into 63 bits.
    """
    n, cells = geometry.size, len(order.cells)
    codes = rules.alphabet**n
    if codes >= 2**63:
        raise SearchError(
            f"{rules.alphabet} letters in windows of {n} cells give more than 2^63 codes: use fewer letters"
        )
    rotations = geometry.rotations[:turns]
    large = codes > MAX_BITS
    stored = len(order.windows) * turns
    return State(
        np.zeros(cells, np.uint8), np.zeros(cells, np.uint8), np.zeros(cells, np.uint64), geometry.offsets, rotations,
        np.argsort(rotations, axis=1), rules.alphabet ** np.arange(n - 1, -1, -1, dtype=np.int64),
        np.zeros(0 if large else codes // 64 + 1, np.uint64),
        np.full(1 << int(2 * stored).bit_length() if large else 1, _EMPTY, np.int64),
        np.array([0, 0, 0, 0, 1], np.int64), random_state(seed),
    )  # fmt: skip
