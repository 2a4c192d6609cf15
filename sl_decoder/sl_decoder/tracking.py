"""Tracking: dots keep their identity from image to image (paper, end of section III.B).

Most images are decoded by verification: every dot is measured around its predicted place, then letter, place and
neighbours are judged exactly as in a full decoding; dots that enter at the rim are found by recovery. Where too many
fail, and every `refresh` images, the image is decoded from scratch. An identity is a map element seen without
interruption: whatever happens, it is only given to a dot that was verified to be that element in this very image.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sl_decoder.backgrounds import CIRCLE
from sl_decoder.centres import Dots
from sl_decoder.decoded import Decoded
from sl_decoder.decoder import Decoder, check_image
from sl_decoder.following import follow, remember, weigh_on_map
from sl_decoder.interpretation import Interpretation
from sl_decoder.letter_model import LetterModel
from sl_decoder.planes import smoothed
from sl_decoder.recovery import matched_offset

FADED = 0.75  # share of the light that a dot had, below which something covers it
FORGOTTEN = 0.03  # of the logarithm of that light, per image
SAMPLE = 60  # dots from which is seen how the image moved on
ALL_HELD = 0.9  # share of them that a prediction must hold, or another is tried
LEAST_HELD = 0.5  # and without which no prediction is followed


@dataclass(frozen=True, kw_only=True)
class TrackerOptions:
    """Options of the tracker.

    refresh: images between two full decodings. least_share: of the dots of the last image that must be verified, or the
    image is decoded from scratch. least_dots: fewer are not tracked. longest_gap: between two images [s]. reach: search
    radius around the prediction, in units of the local lattice; below half, or a neighbour could be taken.
    """

    refresh: int = 15
    least_share: float = 0.95
    least_dots: int = 25
    longest_gap: float = 0.5
    reach: float = 0.35


class Tracker:
    """Decodes a stream of images with one decoder, image by image in the order of their stamps."""

    def __init__(self, decoder: Decoder, *, options: TrackerOptions | None = None) -> None:
        self._decoder = decoder
        self.options = options or TrackerOptions()
        shape = decoder.codebook.letters.shape
        self._claim = np.full(shape, -1, np.int32)  # rows of the per-dot arrays of the last image
        self._place = np.zeros((0, 2), np.float32)
        self._velocity = np.zeros((*shape, 2), np.float32)  # px/s
        self._footprint = np.zeros((*shape, 3), np.float32)
        self._area = np.zeros(0, np.int32)
        self._colour = np.zeros((0, 3), np.float32)
        self._brightest = np.zeros(shape, np.float32)  # log signal
        self._ids = np.full(shape, -1, np.int32)
        self._next_id = 0
        self._model: LetterModel | None = None
        self._offset = np.float32(0)
        self._stamp: int | None = None
        self._size: tuple[int, ...] = ()
        self._smooth: NDArray[np.uint8] | None = None
        self._since_full = 0
        self._full_count = 0

    def reset(self) -> None:
        """Forget all tracks: the next image is decoded from scratch and its dots get new identities."""
        self._claim[:] = -1
        self._ids[:] = -1
        self._model = None
        self._stamp = None

    def track(self, bgr: NDArray[np.uint8], stamp: int) -> Decoded:
        """Correspondences of the next image (H, W, 3) uint8 BGR, taken at `stamp` [ns], with track_id.

        An image that is older than the last one, of another size or after a long gap starts anew.
        """
        start = time.perf_counter()
        check_image(bgr)
        gap = 0.0 if self._stamp is None else 1e-9 * (stamp - self._stamp)
        usable = self._model is not None and 0.0 < gap <= self.options.longest_gap and bgr.shape == self._size
        if self._stamp is not None and not usable:
            self.reset()
        reading = None
        smooth = self._smooth = smoothed(bgr, self._smooth)
        if usable and self._since_full < self.options.refresh:
            reading = self._verify(smooth, gap)
        tracked = reading is not None
        if reading is None:
            reading = self._decoder.interpret(bgr)
            self._since_full = 0
            self._full_count = reading.decoded()
            self._learn(reading, smooth)
        else:
            self._since_full += 1
        decoded = replace(self._decoder.report(reading, start), tracked=tracked)
        ids = self._identify(reading)
        self._keep(reading, bgr.shape, stamp, gap if usable else 0.0)
        map_v, map_u = self._decoder.elements(decoded.row, decoded.col)
        return replace(decoded, track_id=ids[map_v, map_u], decode_time=time.perf_counter() - start)

    def _verify(self, smooth: NDArray[np.uint8], gap: float) -> Interpretation | None:
        """Decode around the prediction; None when too little of it holds."""
        rows = np.flatnonzero(self._claim.ravel() >= 0)
        if len(rows) < self.options.least_dots:
            return None
        reading = self._follow(smooth, rows, gap)
        return None if reading is None else self._judged(reading, smooth, rows)

    def _follow(self, smooth: NDArray[np.uint8], rows: NDArray[np.intp], gap: float) -> Interpretation | None:
        """The last image's dots, of the map's elements `rows` (N,), measured where they should be after `gap` [s].

        None when too few are found.
        """
        decoder, model = self._decoder, self._model
        assert model is not None
        book = decoder.codebook
        count = len(rows)
        index = np.full(self._claim.shape, -1, np.int32)
        index.ravel()[rows] = np.arange(count, dtype=np.int32)
        shape = self._footprint.reshape(-1, 3).take(rows, axis=0)
        dots = self._claim.ravel().take(rows)
        colour = self._colour.take(dots, axis=0)
        reading = Interpretation(book, decoder.alphabet, _blank(count))
        reading.model = model

        def measure(place: NDArray[np.float32], every: int) -> int:
            return follow(
                index,
                place,
                shape,
                colour,
                every,
                reading.claim,
                smooth,
                book.letters,
                book.lattice.steps,
                model,
                self._offset,
                CIRCLE,
                self.options.reach,
                reading.centre,
                reading.colour,
                reading.covariance,
                reading.noise,
                reading.saturated,
                reading.signal,
                reading.holder_u,
                reading.holder_v,
            )

        last = self._place.take(dots, axis=0)
        motion = self._velocity.reshape(-1, 2).take(rows, axis=0) * np.float32(gap)
        place = _aimed((last + motion, last) if motion.any() else (last,), measure, reading, index)
        n = 0 if place is None else measure(place, 1)
        if n < self.options.least_share * count:
            return None
        reading.set_tracked(n)
        return reading

    def _judged(
        self, reading: Interpretation, smooth: NDArray[np.uint8], rows: NDArray[np.intp]
    ) -> Interpretation | None:
        """Weigh and judge what was followed, and add what came into view; None when too little of it holds."""
        decoder, model, n = self._decoder, reading.model, reading.n
        book = decoder.codebook
        lattice = book.lattice
        area = np.zeros(self._claim.shape, np.int32)
        area.ravel()[rows] = self._area.take(self._claim.ravel().take(rows))
        reading.area[:n] = area[reading.holder_v[:n], reading.holder_u[:n]]
        weigh_on_map(
            reading.claim,
            n,
            reading.colour,
            reading.signal,
            reading.noise,
            book.letters,
            lattice.window,
            model,
            reading.evidence,
            reading.letter,
        )
        self._release_faded(reading)
        reading.judge(decoder.limit)
        kept = reading.decoded()
        if kept < self.options.least_share * len(rows) or kept < self.options.least_dots:
            return None
        reading.recover(smooth, decoder.limit, self._offset)
        reading.finish(decoder.limit)
        if reading.decoded() < 0.5 * self._full_count:
            return None
        return reading

    def _release_faded(self, reading: Interpretation) -> None:
        """Take their elements from the dots that lost light against what they had, and against the others.

        Where an object moves over another, its rim covers a dot bit by bit: what is left has another centre.
        """
        held = reading.claim >= 0
        now, best = reading.signal.take(reading.claim), self._brightest
        change = np.float32(np.median((now - best)[held]))
        faded = held & (now - best < change + np.float32(np.log(FADED)))
        self._brightest = np.where(held, np.maximum(now, best + change - np.float32(FORGOTTEN)), best)
        reading.release(faded)

    def _learn(self, reading: Interpretation, smooth: NDArray[np.uint8]) -> None:
        self._model = reading.model if (reading.claim >= 0).any() else None
        if self._model is None:
            return
        book = self._decoder.codebook
        held = reading.claim >= 0
        self._brightest[held] = reading.signal.take(reading.claim[held])
        self._offset = np.float32(
            matched_offset(
                reading.claim,
                smooth,
                reading.centre,
                reading.covariance,
                reading.signal,
                book.letters,
                book.lattice.steps,
                self._model,
                CIRCLE,
            )
        )
        known = np.zeros(self._claim.shape, np.bool_)
        remember(reading.claim, reading.centre, reading.covariance, book.lattice.steps, self._footprint, known)

    def _identify(self, reading: Interpretation) -> NDArray[np.int32]:
        """Identities (V, U): the old one where the element was held in the last image, new ones elsewhere."""
        held = reading.claim >= 0
        ids = np.where(held, self._ids, -1).astype(np.int32)
        new = held & (ids < 0)
        count = int(new.sum())
        ids[new] = np.arange(self._next_id, self._next_id + count, dtype=np.int64) % (2**31 - 1)
        self._next_id = (self._next_id + count) % (2**31 - 1)
        self._ids = ids
        return ids

    def _keep(self, reading: Interpretation, size: tuple[int, ...], stamp: int, gap: float) -> None:
        """Remember the places for the next image, and the velocities where a dot was seen twice."""
        now, last = reading.claim.ravel(), self._claim.ravel()
        velocity = np.zeros_like(self._velocity)
        both = np.flatnonzero((now >= 0) & (last >= 0))
        if gap > 0 and len(both):
            moved = reading.centre.take(now.take(both), axis=0) - self._place.take(last.take(both), axis=0)
            moved /= np.float32(gap)
            velocity.reshape(-1, 2)[both] = moved
            fresh = np.flatnonzero((now >= 0) & (last < 0))
            if len(fresh):
                velocity.reshape(-1, 2)[fresh] = np.median(moved, axis=0)
                self._brightest.ravel()[fresh] = reading.signal.take(now.take(fresh))
        known = self._footprint[..., 0] > 0
        new = (reading.claim >= 0) & ~known
        if new.any() and known.any():
            self._footprint[new] = np.median(self._footprint[known], axis=0)
        self._velocity = velocity
        self._claim = reading.claim
        self._place = reading.centre
        self._area = reading.area
        self._colour = reading.colour
        self._stamp = stamp
        self._size = size


def _aimed(
    guesses: tuple[NDArray[np.float32], ...],
    measure: Callable[[NDArray[np.float32], int], int],
    reading: Interpretation,
    index: NDArray[np.int32],
) -> NDArray[np.float32] | None:
    """The first of the predicted places (N, 2) [px] that a sample of the dots confirms, else the one that it fits best.

    Moved by what the sample has in common. None when no prediction is any good. A camera that turns round does not go
    on: it is nearer to where it was.
    """
    count = len(guesses[0])
    every = max(1, count // SAMPLE)
    best, most = None, LEAST_HELD * count
    for guess in guesses:
        n = measure(guess, every)
        if n * every > most:
            off = reading.centre[:n] - guess[index[reading.holder_v[:n], reading.holder_u[:n]]]
            best, most = guess + np.median(off, axis=0), n * every
        if most >= ALL_HELD * count:
            break
    return best


def _blank(n: int) -> Dots:
    return Dots(
        centre=np.zeros((n, 2), np.float32),
        colour=np.zeros((n, 3), np.float32),
        covariance=np.ones((n, 3), np.float32),
        area=np.ones(n, np.int32),
        noise=np.ones(n, np.float32),
        saturated=np.zeros(n, np.float32),
        cut=np.zeros(n, np.bool_),
        profile=np.zeros(n, np.float32),
    )
