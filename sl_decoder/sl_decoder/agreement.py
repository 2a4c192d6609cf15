"""Intensities where nothing decoded tells the field: the reading on which neighbouring dots agree."""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.compiled import compiled
from sl_decoder.intensity_field import EDGE

AGREEMENT = 1.5  # neighbours that a reading of a dot's intensity must have more than the next best
FEW_KNOWN = 3  # neighbours whose letters are known, which do not yet tell the field


@compiled
def agreed_field(signal, letter, known, near, level, letter_group, field, field_variance):
    """Field and its variance (N,) at the dots that are not known (N,) bool, where their neighbours agree on one.

    Each letter of a dot's hue names a field at the dot, each letter of its neighbours' hues one at them; of known
    neighbours only their own. The right one is that which most neighbours share: a patch of another albedo reads as
    well as its surroundings, and a neighbour beyond an edge of the albedo has no say. Ties are left as they were.
    """
    count = len(level)
    for i in range(len(near)):
        if known[i]:
            continue
        informed = 0
        for q in range(near.shape[1]):
            informed += near[i, q] >= 0 and known[near[i, q]]
        if informed > FEW_KNOWN:
            continue
        best = second = np.float32(-1)
        readings = 0
        for a in range(count):
            if letter_group[a] != letter_group[letter[i]]:
                continue
            readings += 1
            here = signal[i] - level[a]
            support = total = square = np.float32(0)
            for q in range(near.shape[1]):
                j = near[i, q]
                if j < 0:
                    break
                error = np.float32(1e9)
                for b in range(count):
                    e = signal[j] - level[b] - here
                    may_be = b == letter[j] if known[j] else letter_group[b] == letter_group[letter[j]]
                    if may_be and abs(e) < abs(error):
                        error = e
                z = error * np.float32(1 / EDGE)
                w = np.float32(1) / (np.float32(1) + z * z)
                support += w
                total += w * error
                square += w * error * error
            if support > best:
                second = best
                best = support
                mean = total / max(support, np.float32(1e-6))
                agreed = here + mean
                spread = max(square / max(support, np.float32(1e-6)) - mean * mean, np.float32(1e-3))
            else:
                second = max(second, support)
        if readings > 1 and best > second + np.float32(AGREEMENT):
            field[i] = agreed
            field_variance[i] = spread * (np.float32(0.3) + np.float32(1) / best)
