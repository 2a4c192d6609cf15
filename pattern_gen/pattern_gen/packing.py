"""Codes packed into 64-bit words, one bit field a cell, and the small compiled functions that all searches share."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from pattern_gen.errors import SearchError

FOLDS = {1: (0, 0, 0), 2: (1, 0, 0), 3: (1, 1, 0), 4: (1, 2, 0), 5: (1, 2, 1), 6: (1, 2, 2)}


def field_bits(alphabet: int) -> int:
    """Bits of a cell's field for letters 0..alphabet-1."""
    return max(1, int(alphabet - 1).bit_length())


def packing(alphabet: int, cells: int) -> NDArray[np.uint64]:
    """Parameters of the packed distance: (5,) uint64: bits of a field, three shifts that fold a field's bits onto its
    lowest, and the mask of the lowest bits.

    Raises:
        SearchError: the code does not fit into 64 bits.
    """
    bits = field_bits(alphabet)
    if bits * cells > 64:
        raise SearchError(
            f"a window of {cells} cells with {alphabet} letters needs {bits * cells} bits, more than the 64 that "
            f"searches with a Hamming distance handle; use a smaller window or at most {2 ** (64 // cells)} letters"
        )
    low = sum(1 << (bits * cell) for cell in range(cells))
    return np.array([bits, *FOLDS[bits], low], dtype=np.uint64)


@intrinsic
def _population_count(typing_context: Any, value: Any) -> Any:
    """Number of set bits of a uint64, as an int64."""

    def codegen(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.int64(types.uint64), codegen


popcount: Any = _population_count  # called with one argument from compiled code


@njit(inline="always")
def fold(difference: np.uint64, pack: NDArray[np.uint64]) -> np.uint64:
    """One bit for each field in which `difference` is not zero."""
    z = difference | (difference >> pack[1])
    z |= z >> pack[2]
    z |= z >> pack[3]
    return z & pack[4]


@njit(inline="always")
def next_random(state: NDArray[np.uint64]) -> np.uint64:
    """xorshift64*: the next 64 random bits; state is (1,) uint64, not zero."""
    x = state[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    state[0] = x
    return x * np.uint64(2685821657736338717)


@njit(inline="always")
def random_below(state: NDArray[np.uint64], n: int) -> Any:
    """A random integer 0..n-1 (n < 2^31)."""
    return np.int64((next_random(state) >> np.uint64(32)) * np.uint64(n) >> np.uint64(32))


@njit(inline="always")
def random_unit(state: NDArray[np.uint64]) -> float:
    """A random float in [0, 1)."""
    return np.float64(next_random(state) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


def random_state(seed: int) -> NDArray[np.uint64]:
    """State of the generator for a seed (any integer)."""
    mixed = np.random.SeedSequence(abs(int(seed))).generate_state(1, np.uint64)
    return np.array([mixed[0] | np.uint64(1)], dtype=np.uint64)
