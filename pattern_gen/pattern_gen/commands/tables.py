"""`tables`: regenerate the paper's three tables beside ours."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2

from pattern_gen.assignment import assign_letters
from pattern_gen.commands.cli import ProgressLine
from pattern_gen.errors import SearchError
from pattern_gen.generation import pattern_of
from pattern_gen.letters import choose_letters
from pattern_gen.search_request import Request
from pattern_gen.tables import CELLS, TITLES, as_csv, as_markdown, compute, picture
from sl_common.commands import make_parser, run_command
from sl_common.files import atomic_path, write_text

MAX_FILE_CELLS = 1_000_000  # larger maps are drawn and listed, but not written


def _parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    parser = make_parser(
        "pattern_gen tables",
        "Search for the maps of the paper's tables, verify them, and write tables, maps and pictures.",
        "  ros2 run pattern_gen tables --output tables --table square --hamming 3",
    )
    parser.add_argument(
        "--output", type=Path, required=True, help="folder for tables.md, tables.csv, maps and pictures"
    )
    parser.add_argument("--table", choices=list(TITLES), action="append", help="only this table (may be repeated)")
    parser.add_argument("--hamming", type=int, action="append", help="only this distance (may be repeated)")
    parser.add_argument("--letters", type=int, action="append", help="only this alphabet size (may be repeated)")
    parser.add_argument(
        "--time-limit", type=float, default=60.0, help="of each search in s of processor time (default 60)"
    )
    parser.add_argument("--paper-time", type=float, default=10.0, help="of the paper's algorithm in s, 0: leave it out")
    parser.add_argument("--seed", type=int, default=0, help="of the random choices")
    return parser


def _run(arguments: argparse.Namespace) -> None:
    cells = [
        cell
        for cell in CELLS
        if (not arguments.table or cell.table in arguments.table)
        and (not arguments.hamming or cell.h in arguments.hamming)
        and (not arguments.letters or cell.alphabet in arguments.letters)
    ]
    if not cells:
        raise SearchError("no cell of the tables has this table, distance and alphabet")
    results = []
    for cell in cells:
        line = ProgressLine(arguments.time_limit)
        try:
            result = compute(
                cell,
                time_limit=arguments.time_limit,
                paper_time=arguments.paper_time,
                seed=arguments.seed,
                report=line,
            )
        finally:
            line.close()
        results.append(result)
        size = result.found.size
        if size[0] * size[1] <= MAX_FILE_CELLS:
            request = Request(alphabet=cell.alphabet, h=cell.h, grid=cell.grid)
            letters = assign_letters(result.found.symbols, choose_letters(cell.alphabet), request)
            pattern = pattern_of(result.found.symbols, request, letters, (1024, 768))
            pattern.save(arguments.output / f"{cell.name}.yaml")
        with atomic_path(arguments.output / f"{cell.name}.png") as temporary:
            cv2.imwrite(str(temporary), picture(result.found.symbols, cell.grid, cell.alphabet)[..., ::-1])
        reached = f"{size[0]}x{size[1]} in {result.seconds:.2f} s"
        print(f"{cell.table} a={cell.alphabet} h={cell.h}: {reached}, verified: {result.verified}", flush=True)
        write_text(arguments.output / "tables.md", as_markdown(results))
        write_text(arguments.output / "tables.csv", as_csv(results))
    if not all(result.verified for result in results):
        raise SearchError("a map did not pass the verification, see tables.md")


def main() -> int:
    """Entry point."""
    return run_command(_parser(), _run)


if __name__ == "__main__":
    sys.exit(main())
