"""Compile the searches ahead of their first use: `python -m pattern_gen.warmup`.

The machine code is cached beside the modules (or in numba's user cache where that folder is read-only), so that no
command or node compiles anything later.
"""

from __future__ import annotations

import time

from pattern_gen.best import LineByLine, Repair
from pattern_gen.pattern import Grid
from pattern_gen.search import search_map
from pattern_gen.search_request import Request
from pattern_gen.shifted_letters import ShiftedLetters


def warm_up() -> float:
    """Run each compiled function once on a tiny map; returns the time taken in [s]."""
    start = time.monotonic()
    for grid in Grid:
        for h in (1, 3):
            request = Request(alphabet=5, h=h, grid=grid)
            search_map(request, rows=4, cols=5, time_limit=300.0)
            small = search_map(request, rows=4, cols=5, method="paper", time_limit=300.0)
            search_map(request, rows=4, cols=5, start=small.symbols, time_limit=300.0)
        Repair(Request(alphabet=5, h=3, grid=grid), 4, 5, 0, 0.4).run(1_000)
    LineByLine(Request(alphabet=5, h=3), 4, 5, 0, 0.5).run(1_000)
    ShiftedLetters(Request(alphabet=5, h=3), 4, 5).run(1_000)
    return time.monotonic() - start


if __name__ == "__main__":
    print(f"searches compiled in {warm_up():.1f} s")
