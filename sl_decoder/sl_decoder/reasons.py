"""Why each blob of an image did, or did not, become a correspondence."""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sl_decoder.compiled import compiled
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
    return _explain(
        reading.n,
        reading.segmented,
        reading.holder_v,
        reading.banned_v,
        reading.mirrored_dots,
        reading.saturated,
        reading.area,
        reading.near,
        reading.conflicts,
        reading.at,
    )


@compiled
def _explain(n, segmented, holder_v, banned_v, mirrored, saturated, area, near, conflicts, at):
    reason = np.empty(n, np.uint8)
    for i in range(n):
        if holder_v[i] >= 0:
            reason[i] = Reason.DECODED
        elif i < segmented and mirrored[i]:
            reason[i] = Reason.MIRRORED
        elif i >= segmented or banned_v[i] >= 0:
            reason[i] = Reason.IMPROBABLE
        elif saturated[i] > SATURATED_SHARE:
            reason[i] = Reason.SATURATED
        elif _too_small(i, area, near, holder_v):
            reason[i] = Reason.TOO_SMALL
        elif conflicts[i]:
            reason[i] = Reason.INCONSISTENT
        elif at[i] < 0:
            reason[i] = Reason.NO_NEIGHBOURS
        else:
            reason[i] = Reason.UNKNOWN_CODE
    return reason


@compiled
def _too_small(i, area, near, holder_v):
    """Whether a blob is too small to be a dot of the lattice around it, or of any."""
    if area[i] < SMALLEST_CORE:
        return True
    if i >= len(near):
        return False
    total = 0
    number = 0
    for j in near[i]:
        if j >= 0 and holder_v[j] >= 0:
            total += area[j]
            number += 1
    return number > 0 and area[i] * number < SMALL_SHARE * total
