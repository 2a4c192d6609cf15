"""The paper's three tables beside our sizes: which cells there are, and how one is computed, verified and drawn."""

from __future__ import annotations

import csv
import io
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pattern_gen.errors import SearchError
from pattern_gen.pattern import Grid
from pattern_gen.search import search_map
from pattern_gen.search_request import Found, Reading, Report, Request
from pattern_gen.verification import verify_map


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    Attributes:
        table: "square", "hexagonal" or "morano".
        paper: the paper's result, as printed.
        target: (rows, cols) that we search for.
        reading: condition on own rotations.
    """

    table: str
    alphabet: int
    h: int
    paper: str
    target: tuple[int, int]
    reading: Reading = Reading.STRICT

    @property
    def grid(self) -> Grid:
        """Kind of grid."""
        return Grid.HEXAGONAL if self.table == "hexagonal" else Grid.SQUARE

    @property
    def name(self) -> str:
        """For files."""
        return f"{self.table}_a{self.alphabet}_h{self.h}"


def _cells(table: str, h: int, papers: str, targets: str, alphabets: tuple[int, ...]) -> list[Cell]:
    sizes = [tuple(int(part) for part in target.split("x")) for target in targets.split()]
    return [
        Cell(table, a, h, paper, (size[0], size[1]))
        for a, paper, size in zip(alphabets, papers.split(), sizes, strict=True)
    ]


_TO_8 = tuple(range(2, 9))
CELLS: list[Cell] = [
    *_cells("square", 1, "11x14 28x37 70x93 177x236 205x270 372x496 316x421",
            "11x14 49x65 187x251 520x693 1222x1630 1500x2000 1500x2000", _TO_8),
    *_cells("square", 3, "4x5* 9x12 14x18 23x30 44x58 57x75 75x100",
            "4x5 9x12 18x24 36x48 62x83 99x132 159x212", _TO_8),
    *_cells("square", 5, "3x4* 4x5* 5x7 8x10 10x13 13x17 10x13", "3x4 4x5 6x7 8x10 10x13 13x17 19x25", _TO_8),
    Cell("hexagonal", 2, 1, "6x8", (6, 9), Reading.BASE),
    *_cells("hexagonal", 1, "9x13 14x20 15x22 27x40 28x42 28x42 45x68",
            "15x23 36x55 78x120 151x232 262x403 421x648 1000x1500", (*_TO_8[1:], 14)),
    *_cells("hexagonal", 3, "impossible 5x6 7x9 8x11 8x11 10x14 10x14 10x14",
            "3x5 5x6 7x9 9x14 12x18 16x25 22x29 60x92", (*_TO_8, 14)),
    *_cells("hexagonal", 5, "3x4* 4x5 4x5 5x6 5x6 5x6", "3x5 4x5 4x6 5x6 5x8 8x12", (*_TO_8[2:], 14)),
    *_cells("morano", 1, "49x49 85x85 172x172 367x367 449x449 460x460",
            "57x57 216x216 600x600 1411x1411 1732x1732 1732x1732", _TO_8[1:]),
    *_cells("morano", 3, "10x10 17x17 31x31 42x42 73x73 116x116", "11x11 21x21 39x39 68x68 114x114 183x183", _TO_8[1:]),
]  # fmt: skip


@dataclass(frozen=True)
class Result:
    """What became of a cell.

    Attributes:
        found: our map.
        seconds: processor time of our search.
        paper_size, paper_seconds: of the paper's algorithm, run here; None: no map.
        paper_exhausted: it came to the end of its search space.
        verified: the map passed the verification.
    """

    cell: Cell
    found: Found
    seconds: float
    paper_size: tuple[int, int] | None
    paper_seconds: float
    paper_exhausted: bool
    verified: bool


def compute(cell: Cell, *, time_limit: float, paper_time: float, seed: int = 0, report: Report | None = None) -> Result:
    """Search for a cell's map with both methods and verify ours.

    Args:
        time_limit: of our search in [s] of processor time.
        paper_time: of the paper's algorithm, likewise; 0: not run.
    """
    request = Request(alphabet=cell.alphabet, h=cell.h, grid=cell.grid, reading=cell.reading, seed=seed)
    aspect = 1.0 if cell.table == "morano" else 4 / 3
    start = time.process_time()
    try:
        rows, cols = cell.target
        found = search_map(request, rows=rows, cols=cols, time_limit=time_limit, processor_time=True, report=report)
    except SearchError:
        # the size was not reached: the largest of this aspect in as much time again
        found = search_map(request, aspect=aspect, time_limit=time_limit, processor_time=True, report=report)
    seconds = time.process_time() - start
    paper_size, paper_seconds, paper_exhausted = None, 0.0, False
    if paper_time > 0:
        try:
            paper = search_map(
                request, aspect=aspect, method="paper", time_limit=paper_time, processor_time=True, report=report
            )
            paper_size, paper_seconds, paper_exhausted = paper.size, paper.seconds, paper.exhausted
        except SearchError:
            pass
    own_limit = cell.reading.own_distance(cell.h)
    check = verify_map(found.symbols, grid=cell.grid, alphabet=cell.alphabet, h=cell.h, own_limit=own_limit)
    return Result(cell, found, seconds, paper_size, paper_seconds, paper_exhausted, check.problem is None)


def _size(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


def rows_of(results: list[Result]) -> list[list[str]]:
    """The lines of a table as texts."""
    return [
        [
            str(result.cell.alphabet),
            str(result.cell.h),
            result.cell.reading.value,
            result.cell.paper,
            "-" if result.paper_size is None else _size(result.paper_size) + "*" * result.paper_exhausted,
            _size(result.found.size),
            str((result.found.size[0] - 2) * (result.found.size[1] - 2)),
            f"{result.seconds:.2f}",
            "yes" if result.verified else "NO",
        ]
        for result in results
    ]


HEAD = ["a", "h", "reading", "paper", "its algorithm here", "ours", "codes", "time [s]", "verified"]


def as_csv(results: list[Result]) -> str:
    """All results, one line each."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["table", *HEAD])
    for result, row in zip(results, rows_of(results), strict=True):
        writer.writerow([result.cell.table, *row])
    return stream.getvalue()


TITLES = {
    "square": "Square grid, 4:3",
    "hexagonal": "Hexagonal grid, 4:3 image",
    "morano": "Square maps (comparison with Morano)",
}


def as_markdown(results: list[Result]) -> str:
    """The tables."""
    parts = []
    for table, title in TITLES.items():
        chosen = [result for result in results if result.cell.table == table]
        if chosen:
            lines = [f"| {' | '.join(HEAD)} |", "|" + "---|" * len(HEAD)]
            lines += [f"| {' | '.join(row)} |" for row in rows_of(chosen)]
            parts.append(f"### {title}\n\n" + "\n".join(lines) + "\n")
    return "\n".join(parts)


def picture(symbols: NDArray[np.uint8], grid: Grid, alphabet: int) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB: one block of colour a cell, odd columns of a hexagonal map half a cell lower."""
    hue = np.arange(alphabet) / alphabet
    wheel = np.stack([np.cos(2 * np.pi * (hue - shift)) for shift in (0, 1 / 3, 2 / 3)], axis=1)
    light = np.where(np.arange(alphabet) % 2 == 0, 1.0, 0.6)[:, None]
    colours = (255 * light * (0.5 + 0.5 * wheel)).astype(np.uint8)
    scale = max(2, 2 * (600 // (2 * symbols.shape[1])))
    image = np.repeat(np.repeat(colours[symbols], scale, axis=0), scale, axis=1)
    if grid is Grid.SQUARE:
        return image
    half = scale // 2
    canvas = np.zeros((image.shape[0] + half, image.shape[1], 3), dtype=np.uint8)
    odd = (np.arange(symbols.shape[1] * scale) // scale) % 2 == 1
    canvas[: image.shape[0], ~odd] = image[:, ~odd]
    canvas[half:, odd] = image[:, odd]
    return canvas
