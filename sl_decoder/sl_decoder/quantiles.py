"""Quantiles, from a sample of the dots: some hundred of a letter say what thousands say."""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.compiled import compiled

FINEST_BIT = 11  # of a number, to which a quantile is told
PER_LETTER = 170  # dots of a sample, for each letter of the alphabet


@compiled
def sample(use, letters):
    """Indices (M,) int32 of an even sample of the dots in use (N,) bool, for statistics of so many letters."""
    n = np.count_nonzero(use)
    stride = max(1, n // (PER_LETTER * letters))
    chosen = np.empty(n // stride + 2, np.int32)  # one more than there may be
    m = 0
    wait = 0
    for i in range(len(use)):
        take = use[i] and wait == 0
        chosen[m] = i
        m += np.int64(take)
        wait = stride - 1 if take else wait - np.int64(use[i])
    return chosen[:m]


@compiled
def quantile(values, share):
    """Quantile of values (N,) float32, good to 1 in 4000; 0 for none.

    Bisects over the bits of the numbers: counting those below has no branch that depends on them, and is vector code.
    """
    n = len(values)
    if n == 0:
        return np.float32(0)
    rank = np.int32(min(n - 1, int(share * n)))
    key = np.empty(n, np.int32)
    bits = values.view(np.int32)
    for i in range(n):
        key[i] = bits[i] ^ ((bits[i] >> np.int32(31)) & np.int32(0x7FFFFFFF))  # ordered as the values are
    found = np.int64(-(1 << 31))
    for bit in range(31, FINEST_BIT - 1, -1):
        limit = np.int32(found + (1 << bit))
        below = np.int32(0)
        for i in range(n):
            below += np.int32(key[i] < limit)
        found = found if below > rank else np.int64(limit)
    least = np.int32(found)
    return np.int32(least ^ ((least >> np.int32(31)) & np.int32(0x7FFFFFFF))).view(np.float32)
