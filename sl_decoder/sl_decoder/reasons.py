"""Why each blob of an image did, or did not, become a correspondence."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sl_decoder.decoded import Reason
from sl_decoder.interpretation import Interpretation

SATURATED_SHARE = 0.5  # of a dot's core, from which its letter is not trusted
SMALLEST_CORE = 3  # pixels of a core that has a shape and a colour of its own
SMALL_SHARE = 0.25  # of the cores of the decoded dots around it, below which a blob is none of them


def explain(reading: Interpretation) -> NDArray[np.uint8]:
    """Reasons (N,) uint8 (`Reason`) of all dots of an interpretation, recovered ones included.

    The first that applies: decoded, mirrored, improbable, saturated, too small, inconsistent, no neighbours; what
    remains has a whole lattice around it and still no place in the map.
    """
    n, m = reading.n, reading.segmented
    reason = np.full(n, Reason.DECODED, np.uint8)
    reason[:m] = Reason.UNKNOWN_CODE
    reason[:m][reading.at < 0] = Reason.NO_NEIGHBOURS
    reason[:m][reading.conflicts] = Reason.INCONSISTENT
    held = reading.holder_v[:n] >= 0
    reason[:m][_too_small(reading, held[:m])] = Reason.TOO_SMALL
    reason[reading.saturated[:n] > SATURATED_SHARE] = Reason.SATURATED
    reason[reading.banned_v[:n] >= 0] = Reason.IMPROBABLE
    if reading.mirrored:
        reason[:m][reading.mirrored_dots] = Reason.MIRRORED
    reason[held] = Reason.DECODED
    return reason


def _too_small(reading: Interpretation, held: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Blobs (M,) bool that are too small to be dots of the lattice around them, or of any."""
    area = reading.area[: len(held)]
    small = area < SMALLEST_CORE
    free = np.flatnonzero(~held & ~small)
    if len(free) and len(reading.near):
        near = reading.near[free]
        decoded = (near >= 0) & held[near]
        number = decoded.sum(1)
        mean = np.where(decoded, area[near], 0).sum(1) / np.maximum(number, 1)
        small[free[(number > 0) & (area[free] < SMALL_SHARE * mean)]] = True
    return small
