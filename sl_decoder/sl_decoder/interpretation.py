"""Interpretation of one image's dots: graph, letters, placement in the map, growth, judgement, recovery."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sl_decoder import (
    graph,
    growth,
    judgement,
    letters,
    orientation,
    placement,
    recovery,
    surroundings,
    voting,
    windows,
)
from sl_decoder.agreement import agreed_field
from sl_decoder.backgrounds import CIRCLE
from sl_decoder.intensity_field import local_field
from sl_decoder.lattice import mirrored
from sl_decoder.letter_model import any_letter, fit_model, letter_evidence, log_signal
from sl_decoder.nearest import nearest
from sl_decoder.state import State

SMALLEST_COMPONENT = 4  # dots; smaller components take part in growth only
NEXT_EVIDENCE = 14.0  # log-likelihood ratio that further placements need once the pattern is known to be there
PLACED_BELIEF = 1.5  # log-odds from which a placed dot may claim its element
JUDGEMENTS = 12  # most releases of the worst per growth
GROWTHS = 4
MIRROR_VOTES = 5  # windows of a component that agree on a mirrored placement
NOT_OURS = -20.0  # letter evidence of dots that cannot be the pattern's
# log-odds asked of a dot beyond the limit, per kind of prediction: of a segmented dot, of a recovered one
RIM = np.array([[0.0, 0.0, 2.0, 2.0], [0.0, 2.5, 4.5, 4.5]], np.float32)
CHANCE = 0.03  # share of the dots on lattices that must be decoded: less is chance
RECOVERED_LEAST = -1.0  # least letter evidence of a recovered dot


class Interpretation(State):
    """The stages, which each go on from what is known of an image's dots; see the module."""

    def build_graph(self) -> None:
        """Lattice links and connected components."""
        self.near = nearest(self.centre[: self.n], graph.NEIGHBOURS)
        self.links, self.quality = self._link(slice(self.n), self.near, graph.BLUR)
        self._lay_out(self.links, self.quality)

    def _link(
        self, dots: NDArray[np.intp] | slice, near: NDArray[np.int32], blur: float | None
    ) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        """Lattice links of dots (M,) among themselves, as indices of `dots`, and their quality.

        blur: of the metric of the footprints [px^2]; None: in the two directions of the histogram of the whole image.
        """
        directions = self.book.lattice.directions
        centre = self.centre[dots]
        shape = graph.smooth_shapes(self.covariance[dots], near, graph.BLUR if blur is None else blur)
        if blur is None:
            return orientation.links(centre, shape, near, directions)
        links = np.empty((len(near), directions), np.int32)
        quality = np.empty(len(near), np.float32)
        graph.local_bases(centre, shape, near, directions, graph.TOLERANCE, links, quality)
        return links, quality

    def _lay_out(self, links: NDArray[np.int32], quality: NDArray[np.float32]) -> None:
        """Follow the links to components, and lay these out on their lattices."""
        self.component, frame, self.u, self.v = (np.empty(self.segmented, np.int32) for _ in range(4))
        count, self.conflicts = graph.components(
            links, quality, self.book.lattice.steps, self.component, frame, self.u, self.v
        )
        self.cell, self.at, self.width, self.lattices = windows.lay_out(
            self.component, self.u, self.v, self.conflicts, count, SMALLEST_COMPONENT
        )

    def read_letters(self, first: NDArray[np.float64] | None = None) -> None:
        """First reading of the letters, from the image alone or from calibrated colours `first` (A, 3) B G R."""
        self.model, self.signal, self.field, self.variance = letters.initial_letters(
            self.alphabet, self.centre, self.colour, self.profile, self.near, self.at >= 0, first
        )
        self.weigh_letters()

    def weigh_letters(self) -> None:
        """Evidence for each letter of each dot, from the current model and field."""
        n, model = self.n, self.model
        assert model is not None
        letter_evidence(
            model,
            self.colour[:n],
            self.profile,
            self.signal[:n],
            self.field[:n],
            self.variance[:n],
            self.noise[:n],
            self.evidence[:n],
            self.letter[:n],
        )
        if self.mirrored:
            self.evidence[: self.segmented][self.mirrored_dots] = NOT_OURS

    def correct_letters(self) -> None:
        """Replace the letters that were read by those that the paper's voting elects."""
        book = self.book
        score = voting.vote(self.cell, self.at, self.width, self.letter, book.lattice.window, book.alphabet, book.codes)
        self.letter[: self.n] = voting.elect(score, self.letter[: self.n])

    def place_rest(self, blur: float | None) -> int:
        """Place what is left: components of the dots that hold no element yet; returns how many dots that gave.

        A link that jumps over a depth edge joins surfaces whose lattices do not continue each other; all beyond it has
        wrong coordinates, or two of them. Without the dots that are decoded, what is left falls apart into its own
        lattices. blur: of the metric in which they are linked [px^2], none is right for all dots of all images; None:
        as the paper links them.
        """
        self._release_misplaced()
        free = np.flatnonzero((self.holder_v[: self.segmented] < 0) & ~self.mirrored_dots)
        if len(free) < len(self.book.lattice.window):
            return 0
        links, quality = self._link(free, nearest(self.centre[free], graph.NEIGHBOURS), blur)
        linked = np.full_like(self.links, -1)
        linked[free] = self.links[free] = np.where(links >= 0, free[links], -1)
        good = np.full_like(self.quality, np.inf)
        good[free] = quality
        at, conflicts = self.at, self.conflicts
        held, holders = self.claim.copy(), self.places[:2].copy()
        self._lay_out(linked, good)
        self.place(NEXT_EVIDENCE)
        found = (self.claim >= 0) & (held < 0)
        dots = self.claim[found]
        held[found] = dots
        holders[:, dots] = self.places[:2, dots]
        self.claim, self.places[:2] = held, holders
        self.at = np.where(self.at >= 0, self.at, at)  # for the reasons only
        self.conflicts &= conflicts
        return len(dots)

    def place(self, first_evidence: float) -> int:
        """Windows vote, placements are verified and claim their elements; returns how many were accepted."""
        book = self.book
        lattice = book.lattice
        self.claim[:] = -1
        self.places[:] = -1
        votes = windows.window_votes(
            self.cell,
            self.at,
            self.width,
            self.component,
            self.u,
            self.v,
            self.letter,
            lattice.window,
            book.alphabet,
            book.codes,
            book.values,
            book.map_codes,
            lattice.turn,
        )
        found, of = windows.rank_placements(votes, self.component, 1)
        self.accepted = placement.place(
            found,
            of,
            votes,
            self.cell,
            self.at,
            self.width,
            self.u,
            self.v,
            self.evidence[: self.n],
            any_letter(self.evidence[: self.n], self.alphabet.share),
            book.letters,
            lattice.window,
            lattice.turn,
            placement.COUPLING,
            placement.SWEEPS,
            first_evidence,
            NEXT_EVIDENCE,
            PLACED_BELIEF,
            self.claim,
            self.holder_u,
            self.holder_v,
        )
        return self.accepted

    def refuse_mirrored(self) -> bool:
        """Take the components out whose windows lie in the mirrored map; returns whether there are any.

        A mirror image is not nothing but wrong: along the axes of reflection its letters agree with the map's own. So a
        component counts as mirrored when more of its windows agree on one mirrored placement than on any direct one.
        """
        book = self.book
        lattice = book.lattice
        du, dv = mirrored(lattice.window[:, 0], lattice.window[:, 1], hexagonal=book.hexagonal)
        mu, mv = mirrored(self.u, self.v, hexagonal=book.hexagonal)
        best = []
        for window, u, v in ((lattice.window, self.u, self.v), (np.stack([du, dv], 1).astype(np.int32), mu, mv)):
            votes = windows.window_votes(
                self.cell,
                self.at,
                self.width,
                self.component,
                u,
                v,
                self.letter,
                window,
                book.alphabet,
                book.codes,
                book.values,
                book.map_codes,
                lattice.turn,
            )
            found, _ = windows.rank_placements(votes, self.component, 1)
            most = np.zeros(int(self.component.max()) + 1, np.int64)
            np.maximum.at(most, found[:, 0], found[:, 4])
            best.append(most)
        wrong_way = (best[1] > best[0]) & (best[1] >= MIRROR_VOTES)
        dots = (self.component >= 0) & wrong_way[self.component]
        if not dots.any():
            return False
        self.cell[self.at[dots & (self.at >= 0)]] = -1
        self.at[dots] = -1
        self.mirrored_dots = dots
        self.mirrored = True
        self.weigh_letters()
        return True

    def grow(self, limit: float) -> None:
        """Grow from the claims over the segmented dots, judge, release what is below `limit`, until it is stable."""
        for turn in range(GROWTHS):
            added = growth.grow(
                self.claim,
                self.holder_u,
                self.holder_v,
                self.banned_u,
                self.banned_v,
                self.centre,
                self.near,
                self.evidence,
                self.book.letters,
                self.book.lattice.steps,
                growth.REACH,
            )
            if turn and not added:
                return
            self.judge(limit)

    def _release_misplaced(self) -> None:
        """Release the dots whose surroundings' letters do not speak for their place."""
        surroundings.release_misplaced(
            self.claim,
            self.letter,
            self.evidence,
            self.alphabet.share,
            self.book.letters,
            self.holder_u,
            self.holder_v,
        )

    def judge(self, limit: float) -> None:
        """Judge all claims; release the worst below `limit` and judge again until none is left."""
        judgement.judge(
            self.claim,
            self.segmented,
            self.centre,
            self.area,
            self.covariance,
            self.evidence,
            self.book.letters,
            self.book.lattice.steps,
            self.book.lattice.window,
            self.pixel,
            np.float32(limit),
            JUDGEMENTS,
            self.kind,
            self.belief,
            self.holder_u,
            self.holder_v,
            self.banned_u,
            self.banned_v,
        )

    def finish(self, limit: float) -> None:
        """Release dots still below `limit`, and those whose centres are wrong: cut by the border, lit unevenly.

        Where a dot has no neighbours on one side, half a dot of its letter is what it is most easily taken for: there
        more than `limit` is asked. Lattices of which next to nothing agrees with the map are another pattern's.
        """
        if not self.tracked:  # what is was in its place in the image before
            self._release_misplaced()
        held = judgement.release_doubtful(
            self.claim,
            self.belief,
            self.kind,
            self.segmented,
            self.cut,
            np.float32(limit),
            RIM,
            self.holder_u,
            self.holder_v,
        )
        if held < CHANCE * np.count_nonzero(self.at >= 0):
            self.release(self.claim >= 0)

    def refit(self) -> None:
        """Fit the letter model to the decoded dots, and weigh all letters again."""
        self._release_misplaced()
        n, model = self.n, self.model
        assert model is not None
        held = self.holder_v[:n] >= 0
        known = np.where(held, self.book.letters[self.holder_v[:n], self.holder_u[:n]], self.letter[:n]).astype(
            np.int32
        )
        self.signal[:n] = log_signal(self.colour[:n], model.direction, self.alphabet.group[known])
        local_field(
            self.centre[:n], self.signal[:n], self.near, known, model.level, held, self.field[:n], self.variance[:n]
        )
        self.model = fit_model(
            self.alphabet,
            self.colour[:n],
            self.profile,
            self.signal[:n],
            self.field[:n],
            known,
            held,
            model.direction,
            model.level,
        )
        agreed_field(
            self.signal[:n],
            known,
            held,
            self.near,
            self.model.level,
            self.model.group,
            self.field[:n],
            self.variance[:n],
        )
        self.weigh_letters()

    def include_recovered(self) -> None:
        """Let the recovered dots take part in growth and in the fit of the letters."""
        more = self.n - len(self.near)
        self.near = nearest(self.centre[: self.n], graph.NEIGHBOURS)
        self.profile = np.append(self.profile, np.full(more, np.nan, np.float32))
        self.field = np.append(self.field, np.zeros(more, np.float32))
        self.variance = np.append(self.variance, np.ones(more, np.float32))

    def recover(self, smooth: NDArray[np.uint8], limit: float, offset: np.float32 = recovery.UNKNOWN_OFFSET) -> None:
        """Measure the dots that the lattice expects and segmentation did not give; judge.

        offset: of the log signal measured at a known place from that of the other dots, where it is known.
        """
        book, lattice, model = self.book, self.book.lattice, self.model
        assert model is not None
        free = int(np.count_nonzero((self.claim < 0) & (book.letters >= 0)))
        if not free:
            return
        self.make_room(free)
        tried = np.zeros(self.claim.shape, np.bool_)
        before = self.n
        self.n = recovery.recover(
            self.claim,
            self.holder_u,
            self.holder_v,
            tried,
            self.n,
            smooth,
            self.centre,
            self.colour,
            self.covariance,
            self.area,
            self.noise,
            self.saturated,
            self.signal,
            self.evidence,
            self.letter,
            book.letters,
            lattice.steps,
            lattice.window,
            model,
            offset,
            CIRCLE,
            recovery.REACH,
            RECOVERED_LEAST,
        )
        if self.n > before:
            self.judge(limit)
            if not self.tracked:
                # at the rim, what is too faint to be segmented is often half lit: its centre cannot be trusted
                self.release((self.claim >= before) & (self.kind >= growth.EXTRAPOLATED))
