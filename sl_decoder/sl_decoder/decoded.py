"""What the decoder returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class Reason(IntEnum):
    """Why a blob did or did not become a correspondence."""

    DECODED = 0
    SATURATED = 1  # most of its core is saturated: no letter can be read
    TOO_SMALL = 2  # too few pixels for a dot of this lattice, or of any
    NO_NEIGHBOURS = 3  # no lattice around it
    INCONSISTENT = 4  # its neighbourhood contradicts itself
    UNKNOWN_CODE = 5  # its window is not in the map, nor near to what is
    IMPROBABLE = 6  # belongs to a decoded patch by position, but letter, place or neighbours speak against it
    MIRRORED = 7  # seen in a mirror: its windows are in the mirrored map only


REASON_TEXT = {
    Reason.DECODED: "decoded",
    Reason.SATURATED: "saturated",
    Reason.TOO_SMALL: "too small",
    Reason.NO_NEIGHBOURS: "no neighbours",
    Reason.INCONSISTENT: "inconsistent",
    Reason.UNKNOWN_CODE: "unknown code",
    Reason.IMPROBABLE: "improbable",
    Reason.MIRRORED: "mirrored",
}


def _empty(*shape: int, dtype: type = np.float32) -> NDArray:
    return np.empty(shape, dtype)


@dataclass(frozen=True)
class Inspection:
    """All M blobs of the image, for debug images and diagnostics.

    centre (M, 2) float32 px; letter (M,) int32 as read; links (M, D) int32 lattice neighbours or -1; reason (M,) uint8.
    """

    centre: NDArray[np.float32] = field(default_factory=lambda: _empty(0, 2))
    letter: NDArray[np.int32] = field(default_factory=lambda: _empty(0, dtype=np.int32))
    links: NDArray[np.int32] = field(default_factory=lambda: _empty(0, 4, dtype=np.int32))
    reason: NDArray[np.uint8] = field(default_factory=lambda: _empty(0, dtype=np.uint8))

    def counts(self) -> dict[str, int]:
        """Number of blobs per reason, by its text; reasons that do not occur are left out."""
        number = np.bincount(self.reason, minlength=len(Reason))
        return {REASON_TEXT[reason]: int(number[reason]) for reason in Reason if number[reason]}


@dataclass(frozen=True)
class Decoded:
    """Correspondences of one image, N entries each, sorted by row, then column.

    row, col (N,) int32 of the pattern; camera (N, 2) float32 dot centres in the raw image [px]; projector (N, 2)
    float32 spot centres in the projected image [px]; confidence (N,) float32 probability that row and col are right;
    corrected (N,) uint8 1 where the letter read is not the map's; track_id (N,) int32, -1 without tracking.

    blobs, labelled, inconsistent, rejected: counts as in the message; decode_time [s]; mirrored: the image shows the
    pattern in a mirror, which is refused; tracked: found around the prediction, not by full decoding.
    """

    row: NDArray[np.int32]
    col: NDArray[np.int32]
    camera: NDArray[np.float32]
    projector: NDArray[np.float32]
    confidence: NDArray[np.float32]
    corrected: NDArray[np.uint8]
    track_id: NDArray[np.int32]
    blobs: int = 0
    labelled: int = 0
    inconsistent: int = 0
    rejected: int = 0
    decode_time: float = 0.0
    mirrored: bool = False
    tracked: bool = False
    inspection: Inspection = field(default_factory=Inspection)

    def __len__(self) -> int:
        return len(self.row)


def nothing(**counts: object) -> Decoded:
    """A result without correspondences; `counts` sets the remaining fields."""
    return Decoded(
        row=_empty(0, dtype=np.int32),
        col=_empty(0, dtype=np.int32),
        camera=_empty(0, 2),
        projector=_empty(0, 2),
        confidence=_empty(0),
        corrected=_empty(0, dtype=np.uint8),
        track_id=_empty(0, dtype=np.int32),
        **counts,  # type: ignore[arg-type]
    )
