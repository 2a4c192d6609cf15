"""Which three letters may follow two finished lines: look-ups for the search line by line (square grid, 3x3 windows).

A window's top six cells lie in two finished lines, its last three in the line to be filled. A stored code (of any
rotation of any window) that differs from the top six cells in d < h cells forbids all triples of letters within h - 1
- d of its own last three: one visit of the stored codes judges all a^3 triples, as bits of a few words.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pattern_gen.packing import field_bits, fold, popcount

PAIRS_UP_TO = 3  # up to this distance, one of three pairs of the top cells is equal in near codes: tables on pairs


class Stored(NamedTuple):
    """The codes of the finished lines, in tables keyed on pairs of the top six cells (one list of all for large h)."""

    codes: NDArray[np.uint64]  # (lines, codes of a line) packed, of every rotation
    buckets: NDArray[np.uint64]  # (tables, keys, capacity)
    fill: NDArray[np.int64]  # (tables, keys)
    shifts: NDArray[np.uint64]  # (tables,) where a table's pair stands in a packed code
    key_mask: NDArray[np.uint64]  # (1,)
    balls: NDArray[np.uint64]  # (h, packed triples, words) triples within 0..h-1 of a triple, one bit each
    every: NDArray[np.uint64]  # (words,) all triples
    overflow: NDArray[np.bool_]  # (1,) a bucket was too small: make them larger


def make_stored(lines: int, width: int, alphabet: int, h: int, turns: int, spare: float) -> Stored:
    """Empty tables for maps of lines x width cells; `spare`: room in the buckets over that for even letters."""
    bits, cube = field_bits(alphabet), alphabet**3
    line_codes = (width - 2) * turns
    entries = lines * line_codes
    tables, mask, capacity = 1, 0, entries
    if h <= PAIRS_UP_TO:
        tables, mask = 3, (1 << (2 * bits)) - 1
        mean = entries / alphabet**2
        capacity = min(entries, int(spare * (mean + 6.0 * np.sqrt(mean) + 16.0)))
    letters = np.stack(np.unravel_index(np.arange(cube), (alphabet,) * 3), axis=1)
    packed = (letters << (bits * np.arange(3))).sum(axis=1)
    gaps = (letters[:, None] != letters[None]).sum(axis=2)
    words = (cube + 63) // 64
    balls = np.zeros((h, 1 << (3 * bits), words), np.uint64)
    for radius in range(h):
        balls[radius, packed] = _as_words(gaps <= radius, words)
    return Stored(
        np.zeros((lines, line_codes), np.uint64), np.zeros((tables, mask + 1, capacity), np.uint64),
        np.zeros((tables, mask + 1), np.int64), (2 * bits * np.arange(tables)).astype(np.uint64),
        np.array([mask], np.uint64), balls, _as_words(np.ones((1, cube), np.bool_), words)[0], np.zeros(1, np.bool_),
    )  # fmt: skip


def _as_words(flags: NDArray[np.bool_], words: int) -> NDArray[np.uint64]:
    """(m, cube) flags as (m, words) words, the first flag in the lowest bit."""
    padded = np.zeros((len(flags), 64 * words), np.uint8)
    padded[:, : flags.shape[1]] = flags
    return np.packbits(padded, axis=1, bitorder="little").view(np.uint64)


@njit(cache=True)
def free_triples(stored: Stored, pack: NDArray[np.uint64], h: int, top: np.uint64, free: NDArray[np.uint64]) -> bool:
    """Write the triples that may follow the six packed letters `top` to free (words,); False: there is none."""
    six = np.uint64(6) * pack[0]
    inside = (np.uint64(1) << six) - np.uint64(1)
    free[:] = stored.every
    for table in range(stored.shifts.shape[0]):
        key = np.int64((top >> stored.shifts[table]) & stored.key_mask[0])
        bucket = stored.buckets[table, key]
        for i in range(stored.fill[table, key]):
            code = bucket[i]
            gap = popcount(fold((code ^ top) & inside, pack))
            if gap < h:
                ball = stored.balls[h - 1 - gap, np.int64(code >> six)]
                for word in range(free.shape[0]):
                    free[word] &= ~ball[word]
    for word in range(free.shape[0]):  # noqa: SIM110 - compiled
        if free[word] != 0:
            return True
    return False


@njit(cache=True)
def push_line(stored: Stored, line: int) -> None:
    """Enter a line's codes into the tables."""
    codes = stored.codes[line]
    capacity = stored.buckets.shape[2]
    for table in range(stored.shifts.shape[0]):
        for i in range(codes.shape[0]):
            key = np.int64((codes[i] >> stored.shifts[table]) & stored.key_mask[0])
            if stored.fill[table, key] < capacity:
                stored.buckets[table, key, stored.fill[table, key]] = codes[i]
            else:
                stored.overflow[0] = True
            stored.fill[table, key] += 1


@njit(cache=True)
def pop_line(stored: Stored, line: int) -> None:
    """Take out the codes of the line that was entered last."""
    codes = stored.codes[line]
    for table in range(stored.shifts.shape[0]):
        for i in range(codes.shape[0]):
            stored.fill[table, np.int64((codes[i] >> stored.shifts[table]) & stored.key_mask[0])] -= 1
