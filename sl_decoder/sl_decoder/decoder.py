"""The decoder: a camera image to camera-projector correspondences."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pattern_gen import Pattern

from sl_common.errors import StructuredLightError
from sl_decoder import centres, graph, growth, judgement, letters, placement, segmentation
from sl_decoder.codebook import build_codebook
from sl_decoder.colours import Colours
from sl_decoder.decoded import Decoded, Inspection, Reason, nothing
from sl_decoder.lattice import from_axial

SMALLEST_IMAGE = 16  # side [px]


@dataclass(frozen=True, kw_only=True)
class DecoderOptions:
    """Options of the decoder; the defaults work.

    min_confidence: dots less certain are left out. max_false_alarms: expected number of wrongly accepted patterns per
    image without any; it sets the evidence that the first placement of an image needs. kernel: side of the background
    filter [px], 0: found from the image.
    """

    min_confidence: float = 0.5
    max_false_alarms: float = 1e-6
    kernel: int = 0


class Decoder:
    """Decodes images of one pattern; keeps no state between images.

    pattern: what is projected. colours: a colour calibration, or None to learn the letters from each image.
    Raises StructuredLightError for a pattern that it cannot read, or colours that do not fit the pattern.
    """

    def __init__(self, pattern: Pattern, *, options: DecoderOptions | None = None, colours: Colours | None = None) -> None:
        self.pattern = pattern
        self.options = options or DecoderOptions()
        self.codebook = build_codebook(pattern)
        self.alphabet = letters.read_alphabet(pattern)
        if colours is not None and len(colours.rgb) != pattern.alphabet:
            raise StructuredLightError(
                f"colours.yaml has {len(colours.rgb)} letters, the pattern {pattern.alphabet}: calibrate with this pattern"
            )
        self.colours = colours

    def decode(self, bgr: NDArray[np.uint8]) -> Decoded:
        """Correspondences of a BGR image (H, W, 3) uint8. Raises StructuredLightError for anything else."""
        start = time.perf_counter()
        check_image(bgr)
        kernel = self.options.kernel or max(12, bgr.shape[1] // 36)
        segments = segmentation.segment(bgr, kernel)
        dots = centres.measure(segments)
        decoded = self._read(dots, start)
        self.ev = decoded[1] if isinstance(decoded, tuple) else None
        return decoded[0] if isinstance(decoded, tuple) else decoded

    def _read(self, dots: centres.Dots, start: float) -> Decoded:
        book = self.codebook
        lattice = book.lattice
        n = len(dots)
        if n < len(lattice.window):
            return nothing(blobs=n, decode_time=time.perf_counter() - start)
        centre = dots.centre
        near = graph.nearest(centre, graph.NEIGHBOURS)
        shape = graph.smooth_shapes(dots.covariance, near)
        links = np.empty((n, lattice.directions), np.int32)
        quality = np.empty(n, np.float32)
        graph.local_bases(centre, shape, near, lattice.directions, graph.TOLERANCE, links, quality)
        component, frame, u, v = (np.empty(n, np.int32) for _ in range(4))
        count, conflicts = graph.components(links, quality, lattice.steps, component, frame, u, v)
        cell, at, width = placement.lay_out(component, u, v, conflicts, count, 4)
        letter, model, signal, field, variance = letters.initial_letters(self.alphabet, centre, dots.colour, near, at >= 0)
        log_p = np.empty((n, book.alphabet), np.float32)
        claim = np.full(book.letters.shape, -1, np.int32)
        belief = np.empty(claim.shape, np.float32)
        own = np.zeros(claim.shape, np.float32)
        ev_letter = np.zeros(claim.shape, np.float32)
        ev_error = np.zeros(claim.shape, np.float32)
        ev_size = np.zeros(claim.shape, np.float32)
        ev_kind = np.full(claim.shape, 3, np.int8)
        holder_u = np.full(n, -1, np.int32)
        holder_v = np.full(n, -1, np.int32)
        trials = np.log(len(book.codes) * float(n))
        first_evidence = trials - np.log(self.options.max_false_alarms)
        least = float(np.log(self.options.min_confidence / (1 - self.options.min_confidence))) if self.options.min_confidence < 1 else 20.0
        accepted = 0
        for turn in range(2):
            letters.log_likelihood(dots.colour, signal, field, variance, dots.noise, self.alphabet.group, model.direction,
                                   model.spread, model.level, model.level_spread, log_p, letter)
            votes, _ = placement.window_votes(cell, at, width, u, v, letter, lattice.window, book.alphabet,
                                              book.codes, book.values, lattice.turn)
            found, of = placement.rank_placements(votes, component, 1)
            claim[:] = -1
            holder_u[:] = -1
            holder_v[:] = -1
            accepted, _ = placement.place(found, of, votes, cell, at, width, component, u, v, log_p, book.letters,
                                          lattice.window, lattice.turn, placement.COUPLING, placement.SWEEPS,
                                          first_evidence, 14.0, 1.5, claim, holder_u, holder_v)
            if not accepted:
                break
            banned_u = np.full(n, -1, np.int32)
            banned_v = np.full(n, -1, np.int32)
            limit = max(least, 2.0)
            for round_ in range(4):
                added = growth.grow(claim, holder_u, holder_v, banned_u, banned_v, centre, near, log_p, book.letters,
                                    lattice.steps, growth.REACH)
                if round_ and not added:
                    break
                for _ in range(12):
                    judgement.gather(claim, centre, dots.area, log_p, book.letters, lattice.steps, ev_letter, ev_error,
                                     ev_kind, ev_size)
                    judgement.own_evidence(claim, ev_letter, ev_error, ev_kind, ev_size, own)
                    judgement.solve(claim, own, lattice.window, belief)
                    if not judgement.release_worst(claim, belief, limit, holder_u, holder_v, banned_u, banned_v):
                        break
            held = holder_v >= 0
            if turn == 0 and held.any():
                known = np.where(held, book.letters[np.maximum(holder_v, 0), np.maximum(holder_u, 0)], letter).astype(np.int32)
                group = self.alphabet.group[known]
                signal = letters.log_signal(dots.colour, model.direction, group)
                letters.local_field(centre, signal, near, known, model.level, held, field, variance)
                model = letters.fit_model(self.alphabet, dots.colour, signal, field, known, held, model.direction, model.level)
        reason = np.full(n, Reason.UNKNOWN_CODE, np.uint8)
        reason[at < 0] = Reason.NO_NEIGHBOURS
        reason[conflicts] = Reason.INCONSISTENT
        reason[(dots.saturated > 0.5) & (at >= 0)] = Reason.SATURATED
        reason[holder_v >= 0] = Reason.DECODED
        ids = np.flatnonzero(holder_v >= 0)
        map_v, map_u = holder_v[ids], holder_u[ids]
        row, col = from_axial(map_u, map_v - book.v_offset, hexagonal=book.hexagonal)
        order = np.lexsort((col, row))
        ids, map_v, map_u, row, col = ids[order], map_v[order], map_u[order], row[order], col[order]
        b = belief[map_v, map_u]
        return Decoded(
            row=row.astype(np.int32),
            col=col.astype(np.int32),
            camera=centre[ids],
            projector=self.pattern.centers[row, col].astype(np.float32),
            confidence=(1.0 / (1.0 + np.exp(-b))).astype(np.float32),
            corrected=(letter[ids] != book.letters[map_v, map_u]).astype(np.uint8),
            track_id=np.full(len(ids), -1, np.int32),
            blobs=n,
            labelled=int((at >= 0).sum()),
            inconsistent=int((reason == Reason.INCONSISTENT).sum()),
            rejected=int(((reason != Reason.DECODED) & (reason != Reason.INCONSISTENT)).sum()),
            decode_time=time.perf_counter() - start,
            inspection=Inspection(centre, letter, links, reason),
        ), dict(letter=ev_letter[map_v, map_u], error=ev_error[map_v, map_u], kind=ev_kind[map_v, map_u], size=ev_size[map_v, map_u], belief=b)


def check_image(bgr: NDArray[np.uint8]) -> None:
    """Raise StructuredLightError unless an image is (H, W, 3) uint8 and large enough."""
    if not isinstance(bgr, np.ndarray) or bgr.ndim != 3 or bgr.shape[2] != 3 or bgr.dtype != np.uint8:
        what = f"{bgr.dtype} array of shape {bgr.shape}" if isinstance(bgr, np.ndarray) else type(bgr).__name__
        raise StructuredLightError(f"the decoder reads BGR images (H, W, 3) uint8, not {what}")
    if min(bgr.shape[:2]) < SMALLEST_IMAGE:
        raise StructuredLightError(f"image of {bgr.shape[1]}x{bgr.shape[0]} px is too small to hold a pattern")
