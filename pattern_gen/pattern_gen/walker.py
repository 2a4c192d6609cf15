"""One depth-first search, taken in slices of steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pattern_gen import depth_first, near_codes, unique_codes
from pattern_gen.fill_order import FillOrder
from pattern_gen.search_request import Request
from pattern_gen.search_rules import DEEPEST, STEPS, Rules
from pattern_gen.windows import window_geometry

SLICE = 0.15  # [s] between reports
FIRST_STEPS = 20_000


class Slices:
    """Numbers of steps that take about SLICE seconds: how often a search reports, never what it finds."""

    def __init__(self, first: int = FIRST_STEPS) -> None:
        self.steps = first

    def took(self, seconds: float) -> None:
        """Adapt to the time that `steps` steps took."""
        self.steps = int(np.clip(self.steps * SLICE / max(seconds, 1e-4), 0.2 * self.steps, 5 * self.steps)) + 1


class Walker:
    """One depth-first search."""

    def __init__(
        self, request: Request, order: FillOrder, cols: int, *, patience: int, deviation: float, seed: int
    ) -> None:
        """`patience`, `deviation`: see search_rules.Rules."""
        geometry = window_geometry(request.grid, request.window)
        band = -1 if request.band is None else request.band
        rules = Rules(cols, request.alphabet, request.h, request.own, band, patience, deviation)
        self.order, self.rules = order, rules
        prepare = unique_codes.prepare_unique if request.h == 1 and band < 0 else near_codes.prepare
        self.state: near_codes.State | unique_codes.State = prepare(
            order, rules, geometry=geometry, turns=request.orientations, seed=seed
        )

    def adopt(self, symbols: NDArray[np.uint8], cells: int) -> None:
        """Keep the first `cells` cells, in the order of filling, of a flat map."""
        depth_first.adopt(self.state, self.order, self.rules, symbols, cells)

    def run(self, steps: int) -> int:
        """Go on for up to so many steps; returns depth_first.RUNNING, DONE or EXHAUSTED."""
        return int(depth_first.search(self.state, self.order, self.rules, steps))

    @property
    def steps(self) -> int:
        """Steps taken."""
        return int(self.state.counters[STEPS])

    @property
    def deepest(self) -> int:
        """Most cells that were ever filled."""
        return int(self.state.counters[DEEPEST])

    def best(self, rows: int, cols: int) -> NDArray[np.uint8]:
        """The top left rows x cols cells of the largest whole map so far."""
        return self.state.best.reshape(-1, self.rules.cols)[:rows, :cols].copy()
