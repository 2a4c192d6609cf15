"""What is known of the dots of one image: the arrays that the stages of its interpretation share.

Per dot: rows of which the first `n` are used; dots that are recovered where the map expects them are appended. Per map
element: (V, U) arrays in axial coordinates, `claim` holds the dot of each.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from sl_decoder import graph
from sl_decoder.alphabet import Alphabet
from sl_decoder.centres import Dots
from sl_decoder.codebook import Codebook
from sl_decoder.letter_model import LetterModel

COMPLETE = 0.98  # share of the lattices' dots from which an image counts as completely decoded
AMID = 6  # of an element and its eight neighbours, from which it lies amid decoded ones
MEASURED = ("centre", "colour", "covariance", "area", "noise", "saturated", "signal", "evidence", "letter")
"""Arrays of what a recovered dot has, too."""


class State:
    """The dots of one image and what is known of them; see the module."""

    def __init__(self, book: Codebook, alphabet: Alphabet, dots: Dots, *, pixel: float = 1.0) -> None:
        """pixel: size of the camera's pixels in those of the image in which the dots were measured."""
        self.book = book
        self.pixel = np.float32(pixel)
        self.alphabet = alphabet
        n = self.n = self.segmented = len(dots)
        self.centre = dots.centre
        self.colour = dots.colour
        self.covariance = dots.covariance
        self.area = dots.area
        self.noise = dots.noise
        self.saturated = dots.saturated
        self.cut = dots.cut
        self.profile = dots.profile
        self.signal, self.field, self.variance = np.zeros((3, n), np.float32)
        self.evidence = np.empty((n, book.alphabet), np.float32)
        self.letter = np.zeros(n, np.int32)
        self.places = np.full((4, n), -1, np.int32)
        self.holder_u, self.holder_v, self.banned_u, self.banned_v = self.places
        shape = book.letters.shape
        self.claim = np.full(shape, -1, np.int32)
        self.belief = np.empty(shape, np.float32)  # these two: of what is judged
        self.kind = np.empty(shape, np.int8)
        self.model: LetterModel | None = None
        self.accepted = 0
        self.tracked = False
        self.mirrored = False
        self.mirrored_dots = np.zeros(n, np.bool_)
        self.lattices: int  # large enough to be placed; these five: of the graph
        self.at: NDArray[np.int32]
        self.component: NDArray[np.int32]
        self.links: NDArray[np.int32]
        self.conflicts: NDArray[np.bool_]
        self.near = np.empty((0, graph.NEIGHBOURS), np.int32)  # none without a graph, as in tracking

    def set_tracked(self, n: int) -> None:
        """Mark the first n dots as measured around predictions: claimed already, without a graph."""
        self.tracked = True
        self.n = self.segmented = n
        self.links = np.full((n, self.book.lattice.directions), -1, np.int32)
        self.at = np.zeros(n, np.int32)
        self.conflicts = np.zeros(n, np.bool_)
        self.cut = np.zeros(n, np.bool_)

    def make_room(self, more: int) -> None:
        """Room for so many more dots behind the first `n`."""
        n = self.n
        for name in MEASURED:
            values = getattr(self, name)
            roomy = np.empty((n + more, *values.shape[1:]), values.dtype)
            roomy[:n] = values[:n]
            setattr(self, name, roomy)
        places = np.full((4, n + more), -1, np.int32)
        places[:, :n] = self.places[:, :n]
        self.places = places
        self.holder_u, self.holder_v, self.banned_u, self.banned_v = places

    def release(self, elements: NDArray[np.bool_]) -> None:
        """Take the dots of these held elements (V, U) away from them."""
        self.holder_u[self.claim[elements]] = -1
        self.holder_v[self.claim[elements]] = -1
        self.claim[elements] = -1

    def decoded(self) -> int:
        """Number of decoded dots."""
        return int(np.count_nonzero(self.claim >= 0))

    def found(self) -> int:
        """Number of decoded dots that segmentation gave."""
        return int(np.count_nonzero(self.holder_v[: self.segmented] >= 0))

    def is_complete(self) -> bool:
        """Whether (nearly) all dots on lattices are decoded, so that a second reading has nothing to gain."""
        on_lattice = self.at >= 0
        decoded = (self.holder_v[: self.segmented] >= 0) & on_lattice
        return int(np.count_nonzero(decoded)) >= COMPLETE * int(np.count_nonzero(on_lattice))

    def explained(self) -> float:
        """Decoded dots per segmented blob."""
        return self.decoded() / max(1, self.segmented)

    def gaps(self) -> float:
        """Share of the elements amid decoded ones for which segmentation gave no dot."""
        amid = cv2.boxFilter((self.claim >= 0).astype(np.uint8), -1, (3, 3), normalize=False) >= AMID
        missing = amid & ((self.claim < 0) | (self.claim >= self.segmented))
        return float(missing.sum()) / max(1, int(amid.sum()))

    def is_small(self, core: float) -> bool:
        """Whether at least half of the blobs have cores of at most so many pixels."""
        area = self.area[: self.segmented]
        return 2 * int(np.count_nonzero(area <= core)) >= max(1, len(area))
