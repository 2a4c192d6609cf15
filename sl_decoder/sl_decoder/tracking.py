"""Tracking: dots keep their identity from image to image (paper, end of section III.B)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sl_decoder.decoded import Decoded
from sl_decoder.decoder import Decoder


class Tracker:
    """Decodes a stream of images with one decoder."""

    def __init__(self, decoder: Decoder) -> None:
        self._decoder = decoder
        self._ids = np.full((decoder.pattern.rows, decoder.pattern.cols), -1, np.int32)
        self._next = 0

    def track(self, bgr: NDArray[np.uint8], stamp: int) -> Decoded:
        """Correspondences of the next image; stamp in nanoseconds."""
        decoded = self._decoder.decode(bgr)
        ids = np.full_like(self._ids, -1)
        old = self._ids[decoded.row, decoded.col]
        new = old < 0
        old = old.copy()
        old[new] = np.arange(self._next, self._next + int(new.sum()))
        self._next += int(new.sum())
        ids[decoded.row, decoded.col] = old
        self._ids = ids
        return replace(decoded, track_id=old)
