"""The decoder: camera image in, camera-projector correspondences out."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from pattern_gen import Pattern

from sl_decoder import centres, graph, growth, letters, placement, segmentation
from sl_decoder.codebook import build_codebook
from sl_decoder.lattice import from_axial


@dataclass(frozen=True, kw_only=True)
class DecoderOptions:
    """Options of the decoder."""

    kernel: int = 0
    min_belief: float = 2.0


@dataclass(frozen=True)
class Decoded:
    """Correspondences of one image, N entries each, sorted by row and column."""

    row: np.ndarray
    col: np.ndarray
    camera: np.ndarray
    projector: np.ndarray
    confidence: np.ndarray
    corrected: np.ndarray
    blobs: int = 0
    labelled: int = 0
    inconsistent: int = 0
    rejected: int = 0
    decode_time: float = 0.0
    debug: dict = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.row)


class Decoder:
    """Decodes images of one pattern."""

    def __init__(self, pattern: Pattern, *, options: DecoderOptions | None = None, colours: object | None = None) -> None:
        self.pattern = pattern
        self.options = options or DecoderOptions()
        self.codebook = build_codebook(pattern)
        self.alphabet = letters.read_alphabet(pattern)

    def decode(self, bgr: np.ndarray) -> Decoded:
        """Correspondences of a BGR image (H, W, 3) uint8."""
        start = time.perf_counter()
        kernel = self.options.kernel or 18
        segments = segmentation.segment(bgr, kernel)
        dots = centres.measure(segments)
        return self._read(dots, len(segments.blobs), start)

    def _read(self, dots: centres.Dots, blobs: int, start: float) -> Decoded:
        book = self.codebook
        lattice = book.lattice
        n = len(dots)
        centre = dots.centre
        near = graph.nearest(centre, 24)
        shape = graph.smooth_shapes(dots.covariance, near)
        links = np.empty((n, lattice.directions), np.int32)
        quality = np.empty(n, np.float32)
        graph.local_bases(centre, shape, near[:, :16], lattice.directions, graph.TOLERANCE, links, quality)
        component, frame, u, v = (np.empty(n, np.int32) for _ in range(4))
        count, conflicts = graph.components(links, quality, lattice.steps, component, frame, u, v)
        cell, at, width = placement.lay_out(component, u, v, conflicts, count, 4)
        use = at >= 0
        letter, model, signal, field_ = letters.initial_letters(self.alphabet, dots.colour, near, use)
        log_p = np.empty((n, book.alphabet), np.float32)
        claim = np.full(book.letters.shape, -1, np.int32)
        holder_v = np.full(n, -1, np.int32)
        holder_u = np.full(n, -1, np.int32)
        belief = np.empty(book.letters.shape, np.float32)
        own = np.zeros(book.letters.shape, np.float32)
        residual = np.empty(book.letters.shape, np.float32)
        members = np.empty(n + 64, np.int32)
        work = np.zeros(n, np.int32)
        dot_belief = np.empty(n, np.float32)
        debug: dict = {}
        for round_ in range(2):
            letters.log_likelihood(dots.colour, signal, field_, dots.noise, self.alphabet.group, model.direction,
                                   model.spread, model.level, model.level_spread, log_p)
            letter = log_p.argmax(1).astype(np.int32)
            votes, codes = placement.window_votes(cell, at, width, u, v, letter, lattice.window, book.alphabet,
                                                  book.codes, book.values, lattice.turn)
            found, of = placement.rank_placements(votes, component, 1)
            claim[:] = -1
            holder_v[:] = -1
            holder_u[:] = -1
            support = np.full(claim.shape, -np.inf)
            need = np.log(len(book.codes) * max(n, 1)) + 10.0
            accepted = 0
            for p in range(len(found)):
                if found[p, 4] < 2 and p > 50:
                    break
                voters = votes[of == p, 0]
                voters = voters[holder_v[voters] < 0]
                if not len(voters):
                    continue
                m, own_p = placement.solve_placement(found[p], voters, cell, at, width, component, u, v, log_p,
                                                     book.letters, lattice.window, lattice.turn, placement.COUPLING,
                                                     placement.SWEEPS, dot_belief, work, members)
                ids = members[:m]
                inside = dot_belief[ids] > 1.5
                total = own_p[inside].sum()
                if total < (need if not accepted else 14.0):
                    continue
                accepted += 1
                ids = ids[inside]
                turn = lattice.turn[found[p, 1]]
                mu = turn[0, 0] * u[ids] + turn[0, 1] * v[ids] + found[p, 2]
                mv = turn[1, 0] * u[ids] + turn[1, 1] * v[ids] + found[p, 3]
                for i, a, b in zip(ids, mu, mv, strict=True):
                    s = min(dot_belief[i], total)
                    if holder_v[i] >= 0 or (claim[b, a] >= 0 and support[b, a] >= s):
                        continue
                    if claim[b, a] >= 0:
                        holder_v[claim[b, a]] = -1
                    claim[b, a] = i
                    holder_v[i] = b
                    holder_u[i] = a
                    support[b, a] = s
            debug["placements"] = found[: min(len(found), 5)]
            if not accepted:
                break
            growth.grow(claim, holder_v, holder_u, centre, near, log_p, book.letters, lattice.steps, growth.REACH, -1.0)
            for _ in range(2):
                growth.judge(claim, centre, log_p, book.letters, lattice.steps, lattice.window, 0.05,
                             growth.COUPLING, growth.SWEEPS, belief, own, residual)
                bad = (claim >= 0) & (belief < self.options.min_belief)
                holder_v[claim[bad]] = -1
                claim[bad] = -1
            held = holder_v >= 0
            if round_ == 0 and held.any():
                known = np.where(held, book.letters[np.maximum(holder_v, 0), np.maximum(holder_u, 0)], letter).astype(np.int32)
                group = self.alphabet.group[known]
                free = ~held
                group[free] = self.alphabet.group[letter[free]]
                signal = letters._signal(dots.colour, model.direction, group)
                letters.local_field(signal, near, known, model.level, held, field_)
                model = letters.fit_model(self.alphabet, dots.colour, signal, field_, known, held, model.direction, model.level)
        ids = np.flatnonzero(holder_v >= 0)
        rv, ru = holder_v[ids], holder_u[ids]
        row, col = from_axial(ru, rv - book.v_offset, hexagonal=book.hexagonal)
        order = np.lexsort((col, row))
        ids, rv, ru, row, col = ids[order], rv[order], ru[order], row[order], col[order]
        b = belief[rv, ru]
        return Decoded(
            row=row.astype(np.int32), col=col.astype(np.int32), camera=centre[ids],
            projector=self.pattern.centers[row, col].astype(np.float32),
            confidence=(1.0 / (1.0 + np.exp(-b))).astype(np.float32),
            corrected=(letter[ids] != book.letters[rv, ru]).astype(np.uint8),
            blobs=blobs, labelled=int((at >= 0).sum()), inconsistent=int(conflicts.sum()), rejected=0,
            decode_time=time.perf_counter() - start, debug=debug,
        )
