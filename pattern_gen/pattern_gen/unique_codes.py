"""Codes for h = 1 in the depth-first search: every code is used once.

One bit a code, or a hash set where that would be too large; small code spaces are numbered by class under rotation,
so that one look-up judges a code and its rotations. Codes are numbers in base a with the cell that is filled last as
the lowest digit, so the bits of all letters of a cell lie side by side. The codes of all rotations of each window are
stored: one look-up judges a letter.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pattern_gen.errors import SearchError
from pattern_gen.fill_order import FillOrder
from pattern_gen.packing import popcount, random_below, random_state
from pattern_gen.search_rules import Rules, cell_steps, fresh_counters, pick
from pattern_gen.windows import WindowGeometry

MAX_BITS = 2**30  # of the table: 128 MB
MAX_CLASSED = 2**15  # codes
_EMPTY = -1


class State(NamedTuple):
    """Everything the compiled search works on."""

    symbols: NDArray[np.uint8]  # (rows * cols,)
    best: NDArray[np.uint8]  # (rows * cols,) symbols of the largest whole map so far
    free: NDArray[np.uint64]  # (rows * cols,) by depth: letters not yet tried
    steps: NDArray[np.int64]  # (2, k, n) see search_rules.cell_steps
    margin: NDArray[np.int64]  # (1,)
    inverse: NDArray[np.int64]  # (k, n)
    powers: NDArray[np.int64]  # (n,) value of each position of a code
    classes: NDArray[np.int32]  # number of each code's class under rotation, 0: equals its own rotation; or empty
    used: NDArray[np.bool_]  # (classes,)
    bits: NDArray[np.uint64]  # one bit a code; empty: another table is used
    hashed: NDArray[np.int64]  # open addressing, -1: empty
    counters: NDArray[np.int64]  # (6,) see search_rules
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
    if state.classes.shape[0] > 0:
        return state.used[state.classes[code]]
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
    margin = state.margin[0]
    width = cols - 2 * margin
    col = margin + window % width
    cell = (margin + window // width) * cols + col
    code = 0
    for i in range(state.steps.shape[2]):
        code += np.int64(state.symbols[cell + state.steps[col & 1, turn, i]]) * state.powers[i]
    return code


@njit(cache=True)
def allowed_letters(state: State, rules: Rules, window: int, place: int) -> np.uint64:
    """Letters for the cell at `place` (now 0) whose code is new and, if asked for, differs from its own rotations."""
    one = np.uint64(1)
    code = _encode(state, rules.cols, window, 0)
    allowed = np.uint64(0)
    for letter in range(rules.alphabet):
        if not _has(state, code + letter * state.powers[place]):
            allowed |= one << np.uint64(letter)
    if rules.own > 0 and allowed != 0 and state.classes.shape[0] == 0:
        for turn in range(1, state.steps.shape[1]):
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
def _place_of(state: State, cols: int, window: int, cell: int) -> int:
    """Position of a cell in a window, -1: it lies outside."""
    width = cols - 2 * state.margin[0]
    col = state.margin[0] + window % width
    centre = (state.margin[0] + window // width) * cols + col
    for i in range(state.steps.shape[2]):
        if centre + state.steps[col & 1, 0, i] == cell:
            return i
    return -1


@njit(cache=True)
def choose(state: State, order: FillOrder, rules: Rules, depth: int) -> int:
    """In random order: the free letter that leaves the next cell the most free letters; ties at random.

    Contexts then run out of letters evenly: nearly all of them keep a free one until nearly all codes are used.
    """
    free = state.free[depth]
    begin, end = order.first[depth + 1], order.first[depth + 2] if depth + 2 < order.first.shape[0] else 0
    if rules.deviation < 1.0 or end <= begin or popcount(free) == 1:
        return pick(free, state.random, rules.deviation)
    cell, next_cell = order.cells[depth], order.cells[depth + 1]
    place = order.places[begin]
    before = place - 1  # where the cell stands in the next window, in raster order
    if cell + 1 != next_cell:
        before = _place_of(state, rules.cols, order.windows[begin], cell)
        if before < 0:
            return pick(free, state.random, rules.deviation)
    state.symbols[cell] = 0
    state.symbols[next_cell] = 0
    code = _encode(state, rules.cols, order.windows[begin], 0)
    best, best_left, ties = 0, -1, 0
    for letter in range(rules.alphabet):
        if (free >> np.uint64(letter)) & np.uint64(1):
            left = 0
            base = code + letter * state.powers[before]
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
def store(state: State, cols: int, window: int, present: bool) -> None:
    """Store a window's codes of all rotations, or take them out."""
    if state.classes.shape[0] > 0:
        state.used[state.classes[_encode(state, cols, window, 0)]] = present
        return
    turns = state.steps.shape[1]
    for i in range(turns):
        turn = i if present else turns - 1 - i
        code = _encode(state, cols, window, turn)
        if _has(state, code) != present:  # a code that equals its own rotation is stored once
            _set(state, code, present)


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
    powers = rules.alphabet ** np.arange(n - 1, -1, -1, dtype=np.int64)
    small, large = codes <= MAX_CLASSED, codes > MAX_BITS
    classes = _number_classes(rotations, powers, rules) if small else np.zeros(0, np.int32)
    used = np.zeros(int(classes.max()) + 1 if small else 0, np.bool_)
    if rules.own > 0:
        used[:1] = True
    stored = len(order.windows) * turns
    return State(
        np.zeros(cells, np.uint8), np.zeros(cells, np.uint8), np.zeros(cells, np.uint64),
        cell_steps(geometry, turns, rules.cols), np.array([geometry.margin], np.int64),
        np.argsort(rotations, axis=1), powers, classes, used,
        np.zeros(0 if large or small else codes // 64 + 1, np.uint64),
        np.full(1 << int(2 * stored).bit_length() if large else 1, _EMPTY, np.int64),
        fresh_counters(), random_state(seed),
    )  # fmt: skip


def _number_classes(rotations: NDArray[np.int64], powers: NDArray[np.int64], rules: Rules) -> NDArray[np.int32]:
    """(codes,) class of each code under rotation, from 1 on; 0 for all codes that must not occur."""
    codes = np.arange(rules.alphabet ** len(powers))
    letters = codes[:, None] // powers % rules.alphabet
    turned = np.stack([letters[:, rotation] @ powers for rotation in rotations], axis=1)
    number = np.unique(turned.min(axis=1), return_inverse=True)[1].astype(np.int32) + 1
    if rules.own > 0:
        number[(turned[:, 1:] == codes[:, None]).any(axis=1)] = 0
    return number
