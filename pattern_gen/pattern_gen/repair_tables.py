"""State of the focused local search, and the bucket tables through which it finds near codes; see local_search.

Look-ups use buckets on the letters of some of the other cells, see `buckets`. By rotation any cell of a window can be
brought to one position of its class (corner, edge, centre), so each class has its tables.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pattern_gen.packing import fold, popcount

MAX_CANDIDATES = 16384  # near codes remembered for one cell


class Tables(NamedTuple):
    """Bucket tables, `count` classes times `tables` each; empty for a linear scan."""

    weights: NDArray[np.int64]  # (classes, tables, n) key = sum of weight * letter
    starts: NDArray[np.int64]  # (classes, tables) first bucket of the table in `fill`
    fill: NDArray[np.int32]  # (buckets,) number of items
    items: NDArray[np.int32]  # (buckets * capacity,)
    slots: NDArray[np.int32]  # (classes, tables, entries) where an entry is inside its bucket
    keys: NDArray[np.int32]  # (classes, tables, entries) bucket of an entry


class State(NamedTuple):
    """Everything the compiled search works on."""

    symbols: NDArray[np.uint8]  # (rows, cols)
    offsets: NDArray[np.int64]  # (2, n, 2)
    rotations: NDArray[np.int64]  # (k, n) code rotated = code[rotations[k]]
    inverse: NDArray[np.int64]  # (k, n) cell p stands at position inverse[k, p] of the rotated code
    class_of: NDArray[np.int64]  # (n,) class of a cell
    turn_of: NDArray[np.int64]  # (n,) the rotation that brings it to its class's position
    place_of: NDArray[np.int64]  # (classes,) that position
    pack: NDArray[np.uint64]  # see packing.packing
    codes: NDArray[np.uint64]  # (windows * k,)
    conflicts: NDArray[np.int32]  # (windows,)
    active: NDArray[np.int32]  # (windows,) windows with conflicts, the first `counters[0]`
    active_at: NDArray[np.int32]  # (windows,) index into `active`, -1: none
    counters: NDArray[np.int64]  # (4,) active windows, conflicts, steps, overflow flag
    random: NDArray[np.uint64]  # (1,)
    found: NDArray[np.int32]  # (MAX_CANDIDATES, 4) near codes: own window's number, entry, distance, letter
    local: NDArray[np.int32]  # (windows,) number of a window among those that hold the cell, -1: none


@njit(cache=True, inline="always")
def letter_at(code: np.uint64, place: int, bits: np.uint64) -> Any:
    """The letter at a place of a packed code."""
    field = (np.uint64(1) << bits) - np.uint64(1)
    return np.int64((code >> (np.uint64(place) * bits)) & field)


@njit(cache=True)
def insert(tables: Tables, table_class: int, table: int, entry: int, key: int, capacity: int) -> bool:
    """Enter a code into the bucket `key`; False: the bucket is full."""
    count = tables.fill[key]
    if count == capacity:
        return False
    tables.items[key * capacity + count] = entry
    tables.slots[table_class, table, entry] = count
    tables.keys[table_class, table, entry] = key
    tables.fill[key] = count + 1
    return True


@njit(cache=True)
def remove(tables: Tables, table_class: int, table: int, entry: int, capacity: int) -> None:
    """Take a code out of its bucket."""
    key = tables.keys[table_class, table, entry]
    count = tables.fill[key] - 1
    tables.fill[key] = count
    slot = tables.slots[table_class, table, entry]
    last = tables.items[key * capacity + count]
    tables.items[key * capacity + slot] = last
    tables.slots[table_class, table, last] = slot


@njit(cache=True, inline="always")
def _remember(state: State, count: int, number: int, entry: int, distance: int, place: int) -> None:
    state.found[count, 0] = number
    state.found[count, 1] = entry
    state.found[count, 2] = distance
    state.found[count, 3] = letter_at(state.codes[entry], place, state.pack[0])


@njit(cache=True)
def near(
    state: State, tables: Tables, capacity: int, h: int, entry: int, table_class: int, number: int, count: int
) -> int:
    """Append the codes at distance below h from code `entry`, without the class's cell, to state.found[count:]."""
    bits = state.pack[0]
    query = state.codes[entry]
    place = state.place_of[table_class]
    mask = ~(np.uint64(1) << (np.uint64(place) * bits))
    turns = state.rotations.shape[0]
    first = count
    table_count = tables.weights.shape[1]
    if table_count == 0:
        for e in range(state.codes.shape[0]):
            distance = popcount(fold(state.codes[e] ^ query, state.pack) & mask)
            if distance < h and state.local[e // turns] < 0 and count < MAX_CANDIDATES:
                _remember(state, count, number, e, distance, place)
                count += 1
        return count
    for table in range(table_count):
        key = tables.keys[table_class, table, entry]
        base = key * capacity
        for item in range(base, base + tables.fill[key]):
            e = tables.items[item]
            distance = popcount(fold(state.codes[e] ^ query, state.pack) & mask)
            if distance < h and state.local[e // turns] < 0 and count < MAX_CANDIDATES:
                known = False
                for i in range(first, count):
                    if state.found[i, 1] == e:
                        known = True
                        break
                if not known:
                    _remember(state, count, number, e, distance, place)
                    count += 1
    return count
