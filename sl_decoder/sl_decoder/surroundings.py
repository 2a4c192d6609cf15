"""Dots judged together with what surrounds them on the map.

Letters that can hardly be told are outweighed one by one by what lies beside them, and a part of a lattice that a wrong
link has shifted looks as good as its neighbours dot by dot. Many such letters together are not outweighed.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.approximation import exponential, logarithm
from sl_decoder.compiled import compiled
from sl_decoder.letter_model import MOST_EVIDENCE, any_letter

REACH = 3  # elements to either side
LEAST_TOGETHER = 4.0  # log-likelihood ratio that a dot and its surroundings must have for their place
MISREAD = 0.1  # share of letters that count nothing
FEW_UNLIKE = 5  # letters unlike the map's in all of the image: no part of it can then be in a wrong place


@compiled
def release_misplaced(claim, letter, evidence, share, map_letters, holder_u, holder_v):
    """Release the held elements whose surroundings' letters do not speak for their place; returns how many.

    claim, map_letters (V, U); letter (N,) as read; evidence (N, A): see `letter_evidence`; share (A,): of the map.
    """
    unlike = 0
    for v in range(claim.shape[0]):
        for u in range(claim.shape[1]):
            unlike += np.int64(claim[v, u] >= 0 and letter[claim[v, u]] != map_letters[v, u])
    if unlike < FEW_UNLIKE:
        return 0
    together = _sum_around(_evidence_for_place(claim, evidence, share, map_letters))
    released = 0
    for v in range(claim.shape[0]):
        for u in range(claim.shape[1]):
            i = claim[v, u]
            if i >= 0 and together[v, u] < np.float32(LEAST_TOGETHER):
                claim[v, u] = holder_u[i] = holder_v[i] = -1
                released += 1
    return released


@compiled
def _evidence_for_place(claim, evidence, share, map_letters):
    """Log-likelihood ratio (V, U) of each held dot's letter here against anywhere in the map; 0 where none is held."""
    anywhere = any_letter(evidence, share)
    most = np.float32(MOST_EVIDENCE)
    scale = np.exp(most)
    out = np.zeros(claim.shape, np.float32)
    for v in range(claim.shape[0]):
        for u in range(claim.shape[1]):
            i = claim[v, u]
            if i >= 0:
                ratio = exponential(evidence[i, map_letters[v, u]] - anywhere[i] - most) * scale
                out[v, u] = logarithm(np.float32(MISREAD) + np.float32(1 - MISREAD) * ratio)
    return out


@compiled
def _sum_around(values):
    """Sums (V, U) of values (V, U) over REACH elements to either side."""
    rows, cols = values.shape
    across, out = np.zeros((rows, cols), np.float32), np.zeros((rows, cols), np.float32)
    for step in range(-REACH, REACH + 1):
        for v in range(rows):
            for u in range(max(0, -step), min(cols, cols - step)):
                across[v, u] += values[v, u + step]
    for step in range(-REACH, REACH + 1):
        for v in range(max(0, -step), min(rows, rows - step)):
            for u in range(cols):
                out[v, u] += across[v + step, u]
    return out
