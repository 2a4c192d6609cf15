"""What is held of the map, listed by row and column."""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.approximation import exponential
from sl_decoder.compiled import compiled


@compiled
def correspondences(claim, belief, centre, letter, map_letters, v_offset, hexagonal, projector):
    """The held elements by row, then column: row, col (N,) int32, camera (N, 2) and projector (N, 2) float32 px,
    confidence (N,) float32, corrected (N,) uint8; see `decoded.Decoded`.

    claim, belief, map_letters (V, U) of the map's elements, centre and letter of the dots; projector (rows, cols, 2).
    """
    rows, cols, _ = projector.shape
    count = 0
    for dot in claim.ravel():
        count += np.int64(dot >= 0)
    row, col = np.empty(count, np.int32), np.empty(count, np.int32)
    camera, projected = np.empty((count, 2), np.float32), np.empty((count, 2), np.float32)
    confidence, corrected = np.empty(count, np.float32), np.empty(count, np.uint8)
    n = 0
    for r in range(rows):
        for u in range(cols):
            v = r + v_offset - ((u - (u & 1)) // 2 if hexagonal else 0)
            i = claim[v, u]
            if i < 0:
                continue
            row[n], col[n] = r, u
            camera[n, 0], camera[n, 1] = centre[i, 0], centre[i, 1]
            projected[n, 0], projected[n, 1] = projector[r, u, 0], projector[r, u, 1]
            # a belief is a log-odds; those of dots that are given are positive
            confidence[n] = np.float32(1) / (np.float32(1) + exponential(-belief[v, u]))
            corrected[n] = letter[i] != map_letters[v, u]
            n += 1
    return row, col, camera, projected, confidence, corrected
