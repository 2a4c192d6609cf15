"""Depth-first search for maps, section II.B: one loop over cells, for unique codes and for codes at a distance.

Letters are tried in ascending order (the paper: a number in base a that only increases), at random, or in ascending
order with rare deviations, which packs small alphabets well and differs from seed to seed. With `patience`, so many
steps without progress are followed by a back-jump: half a row to three rows are undone and drawn again; in ascending
order all are, since what went wrong may lie anywhere.

How codes are stored and judged depends on the state's type: `near_codes.State` or `unique_codes.State`. The functions
`_allowed`, `_add`, `_remove` and `_choose` below are resolved by it when the loop is compiled.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numba.extending import overload
from numpy.typing import NDArray

from pattern_gen import near_codes, unique_codes
from pattern_gen.fill_order import FillOrder
from pattern_gen.packing import random_below
from pattern_gen.search_rules import DEEPEST, DEPTH, ENTERING, FLOOR, SINCE, STEPS, Rules, pick

RUNNING, DONE, EXHAUSTED = 0, 1, 2


def _allowed(state: Any, rules: Rules, window: int, place: int) -> Any:
    """Letters for the cell at `place` of a window, which now holds 0, that keep the window apart; one bit each."""


def _add(state: Any, rules: Rules, window: int) -> None:
    """Store the codes of a window."""


def _remove(state: Any, rules: Rules, window: int) -> None:
    """Take out the codes of the window that was stored last."""


def _choose(state: Any, order: FillOrder, rules: Rules, depth: int) -> Any:
    """One of the letters not yet tried at a depth."""


def _is_unique(state: Any) -> bool:
    return bool(state.instance_class is unique_codes.State)


@overload(_allowed, strict=False)  # the implementations carry no annotations
def _allowed_by_type(state: Any, rules: Any, window: Any, place: Any) -> Any:
    judge = unique_codes.allowed_letters if _is_unique(state) else near_codes.allowed_letters
    return lambda state, rules, window, place: judge(state, rules, window, place)


@overload(_add, strict=False)  # the implementations carry no annotations
def _add_by_type(state: Any, rules: Any, window: Any) -> Any:
    if _is_unique(state):
        return lambda state, rules, window: unique_codes.store(state, rules.cols, window, True)
    return lambda state, rules, window: near_codes.push(state, rules, window)


@overload(_remove, strict=False)  # the implementations carry no annotations
def _remove_by_type(state: Any, rules: Any, window: Any) -> Any:
    if _is_unique(state):
        return lambda state, rules, window: unique_codes.store(state, rules.cols, window, False)
    return lambda state, rules, window: near_codes.pop(state, window)


@overload(_choose, strict=False)  # the implementations carry no annotations
def _choose_by_type(state: Any, order: Any, rules: Any, depth: Any) -> Any:
    if _is_unique(state):
        return lambda state, order, rules, depth: unique_codes.choose(state, order, rules, depth)
    return lambda state, order, rules, depth: pick(state.free[depth], state.random, rules.deviation)


@njit(cache=True)
def start_step(count: NDArray[np.int64], rules: Rules, random: NDArray[np.uint64]) -> int:
    """Count a step; returns the depth to jump back to where there was no progress for too long, else -1."""
    count[STEPS] += 1
    count[SINCE] += 1
    depth = count[DEPTH]
    if rules.patience == 0 or count[SINCE] <= rules.patience or depth <= count[FLOOR]:
        return -1
    if rules.deviation < 1.0:
        jump = depth
    else:
        jump = rules.cols // 2 + random_below(random, 3 * rules.cols) + 1
    count[SINCE] = 0
    count[ENTERING] = 1
    return max(depth - jump, count[FLOOR])


@njit(cache=True)
def end_step(
    count: NDArray[np.int64], symbols: NDArray[np.uint8], best: NDArray[np.uint8], whole: NDArray[np.uint8]
) -> None:
    """Go on to the next cell, and keep the map if it is the largest whole one so far."""
    depth = count[DEPTH]
    count[DEPTH] = depth + 1
    count[ENTERING] = 1
    if depth + 1 > count[DEEPEST]:
        count[DEEPEST] = depth + 1
        count[SINCE] = 0
        if whole[depth]:
            best[:] = symbols


@njit(cache=True)
def _undo(state: Any, order: FillOrder, rules: Rules, depth: int) -> None:
    for i in range(order.first[depth + 1] - 1, order.first[depth] - 1, -1):
        _remove(state, rules, order.windows[i])


@njit(cache=True)
def _place(state: Any, order: FillOrder, rules: Rules, depth: int, letter: int) -> bool:
    """Fill the cell and store the windows that it completes; False, and nothing stored: one is not apart."""
    begin, end = order.first[depth], order.first[depth + 1]
    cell = order.cells[depth]
    for i in range(begin, end):
        if i > begin:  # the first window's letters were judged on entering
            state.symbols[cell] = 0
            allowed = _allowed(state, rules, order.windows[i], order.places[i])
            state.symbols[cell] = letter
            if not (allowed >> np.uint64(letter)) & np.uint64(1):
                for stored in range(i - 1, begin - 1, -1):
                    _remove(state, rules, order.windows[stored])
                return False
        state.symbols[cell] = letter
        _add(state, rules, order.windows[i])
    state.symbols[cell] = letter
    return True


@njit(cache=True)
def search(state: Any, order: FillOrder, rules: Rules, steps: int) -> int:
    """Go on for up to `steps` steps. Returns RUNNING, DONE (all cells filled) or EXHAUSTED (no such map exists)."""
    total = order.cells.shape[0]
    count = state.counters
    one = np.uint64(1)
    every = (one << np.uint64(rules.alphabet)) - one
    for _ in range(steps):
        depth = count[DEPTH]
        if depth == total:
            return DONE
        target = start_step(count, rules, state.random)
        if target >= 0:
            for back in range(depth - 1, target - 1, -1):
                _undo(state, order, rules, back)
            count[DEPTH] = target
            continue
        if count[ENTERING]:
            begin = order.first[depth]
            state.symbols[order.cells[depth]] = 0
            # which letter is which is arbitrary: the first cell is zero
            state.free[depth] = one if depth == 0 else every
            if order.first[depth + 1] > begin:
                state.free[depth] = _allowed(state, rules, order.windows[begin], order.places[begin])
            count[ENTERING] = 0
        if state.free[depth] == 0:
            if depth <= count[FLOOR]:
                return EXHAUSTED
            _undo(state, order, rules, depth - 1)
            count[DEPTH] = depth - 1
            continue
        letter = _choose(state, order, rules, depth)
        state.free[depth] &= ~(one << np.uint64(letter))
        if _place(state, order, rules, depth, letter):
            end_step(count, state.symbols, state.best, order.whole)
    return DONE if count[DEPTH] == total else RUNNING


@njit(cache=True)
def adopt(state: Any, order: FillOrder, rules: Rules, symbols: NDArray[np.uint8], cells: int) -> None:
    """Start from the first `cells` cells of a map (flat); they are never undone."""
    for depth in range(cells):
        state.symbols[order.cells[depth]] = symbols[order.cells[depth]]
    for i in range(order.first[cells]):
        _add(state, rules, order.windows[i])
    state.best[:] = state.symbols
    state.counters[DEPTH] = cells
    state.counters[DEEPEST] = cells
    state.counters[FLOOR] = cells
