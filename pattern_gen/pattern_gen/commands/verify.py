"""`verify`: check a pattern file, independently of the searches."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from pattern_gen.errors import PatternError
from pattern_gen.pattern import Pattern
from pattern_gen.search_request import Reading
from pattern_gen.verification import verify_map
from sl_common.commands import make_parser, run_command


def _parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    parser = make_parser(
        "pattern_gen verify",
        "Check that all windows of a pattern differ as its file says.",
        "  ros2 run pattern_gen verify pattern.yaml",
    )
    parser.add_argument("file", type=Path, help="the pattern file (YAML)")
    parser.add_argument("--hamming", type=int, help="check this distance instead of the file's min_hamming")
    parser.add_argument("--reading", choices=[reading.value for reading in Reading], default="strict",
                        help="own rotations: base: any, strict: differ (default), selfdist: HAMMING apart")  # fmt: skip
    parser.add_argument("--no-rotation-invariance", action="store_true", help="only the given orientation counts")
    parser.add_argument("--epipolar-band", type=int, metavar="ROWS", help="compare only windows at most ROWS apart")
    return parser


def _run(arguments: argparse.Namespace) -> None:
    pattern = Pattern.load(arguments.file)
    h = pattern.min_hamming if arguments.hamming is None else arguments.hamming
    result = verify_map(
        pattern.symbols,
        grid=pattern.grid,
        alphabet=pattern.alphabet,
        h=h,
        own_limit=Reading(arguments.reading).own_distance(h),
        window=pattern.window,
        rotations=not arguments.no_rotation_invariance,
        band=arguments.epipolar_band,
    )
    if result.problem is not None:
        raise PatternError(f"{arguments.file}: {result.problem}")
    print(f"{arguments.file}: {pattern.rows}x{pattern.cols} {pattern.grid.value} map, id {pattern.pattern_id}")
    print(f"codes: {result.windows}")
    print(f"alphabet: {pattern.alphabet}")
    print(f"minimum distance: {'-' if result.closest is None else result.closest.distance} (required {h})")
    if result.own is not None:
        print(f"minimum distance from own rotations: {result.own.distance} (required {result.own_limit})")
    print("ok")


def main() -> int:
    """Entry point."""
    return run_command(_parser(), _run)


if __name__ == "__main__":
    sys.exit(main())
