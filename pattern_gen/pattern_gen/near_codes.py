"""Codes at a Hamming distance for the depth-first search, with look-ups that judge all letters of a cell at once.

A step fills one cell, which completes at most a few windows. With that cell masked out, a stored code (of any rotation
of any window) at distance below h - 1 forbids every letter, one at exactly h - 1 forbids the letter that it has there.
Stored codes are found through buckets on some of the other cells, see `buckets`; the buckets are linked lists,
pushed and popped in the order of the search.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pattern_gen.buckets import cell_classes, choose_keys, table_layout
from pattern_gen.fill_order import FillOrder
from pattern_gen.packing import fold, packing, popcount, random_state
from pattern_gen.search_rules import Rules, cell_steps, fresh_counters
from pattern_gen.windows import WindowGeometry


class State(NamedTuple):
    """Everything the compiled search works on."""

    symbols: NDArray[np.uint8]  # (rows * cols,)
    best: NDArray[np.uint8]  # (rows * cols,) symbols of the largest whole map so far
    free: NDArray[np.uint64]  # (rows * cols,) by depth: letters not yet tried, one bit each
    codes: NDArray[np.uint64]  # (windows * k,)
    steps: NDArray[np.int64]  # (2, k, n) see search_rules.cell_steps
    margin: NDArray[np.int64]  # (1,)
    inverse: NDArray[np.int64]  # (k, n)
    class_of: NDArray[np.int64]  # (n,)
    turn_of: NDArray[np.int64]  # (n,)
    place_of: NDArray[np.int64]  # (classes,)
    pack: NDArray[np.uint64]  # (5,)
    weights: NDArray[np.int64]  # (classes, tables, n)
    starts: NDArray[np.int64]  # (classes, tables)
    heads: NDArray[np.int32]  # (buckets,) newest entry, -1: none
    nexts: NDArray[np.int32]  # (classes, tables, entries) the entry before
    counters: NDArray[np.int64]  # (6,)
    random: NDArray[np.uint64]  # (1,)


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


@njit(cache=True, inline="always")
def _encode(state: State, rules: Rules, window: int, turn: int) -> np.uint64:
    margin = state.margin[0]
    width = rules.cols - 2 * margin
    col = margin + window % width
    cell = (margin + window // width) * rules.cols + col
    code = np.uint64(0)
    shift = np.uint64(0)
    for i in range(state.steps.shape[2]):
        code |= np.uint64(state.symbols[cell + state.steps[col & 1, turn, i]]) << shift
        shift += state.pack[0]
    return code


@njit(cache=True)
def allowed_letters(state: State, rules: Rules, window: int, place: int) -> np.uint64:
    """Letters for the cell at `place` that keep the window apart from all stored ones and from its own rotations."""
    bits = state.pack[0]
    one = np.uint64(1)
    field = (one << bits) - one
    turns = state.steps.shape[1]
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
    width = rules.cols - 2 * state.margin[0]
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
def push(state: State, rules: Rules, window: int) -> None:
    """Store a window's codes of all rotations."""
    turns = state.steps.shape[1]
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
def pop(state: State, window: int) -> None:
    """Take out the codes of the window that was stored last."""
    turns = state.steps.shape[1]
    for turn in range(turns - 1, -1, -1):
        entry = window * turns + turn
        code = state.codes[entry]
        for table_class in range(state.weights.shape[0]):
            for table in range(state.weights.shape[1]):
                state.heads[_key(state, table_class, table, code)] = state.nexts[table_class, table, entry]


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
        np.zeros(windows * turns, np.uint64), cell_steps(geometry, turns, rules.cols),
        np.array([geometry.margin], np.int64), classes.inverse, classes.class_of,
        classes.turn_of, classes.place_of, packing(rules.alphabet, n), weights, starts,
        np.full(buckets, -1, np.int32), np.full((*starts.shape, windows * turns), -1, np.int32),
        fresh_counters(), random_state(seed),
    )  # fmt: skip
