"""`generate`: search for a map and write the pattern file."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from pattern_gen.commands.cli import ProgressLine, size
from pattern_gen.generation import Reading, Request, parse_aspect, pattern_of
from pattern_gen.letters import choose_letters
from pattern_gen.pattern import Grid
from sl_common.commands import make_parser, run_command

EXAMPLE = """\
  ros2 run pattern_gen generate --letters 6 --hamming 3 --rows 44 --cols 58 --output pattern.yaml
  ros2 run pattern_gen generate --letters 6 --hamming 3 --aspect 4:3 --time-limit 30 --output large.yaml
  ros2 run pattern_gen generate --letters 4 --hamming 3 --grid hexagonal --monochrome --output hexagonal.yaml
"""


def _parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    parser = make_parser(
        "pattern_gen generate", "Generate a rotation-invariant map of letters in which all windows differ.", EXAMPLE
    )
    parser.add_argument("--letters", type=int, required=True, help="size of the alphabet, 2 to 36")
    parser.add_argument(
        "--hamming", type=int, default=1, help="least number of differing spots of two windows (default 1)"
    )
    parser.add_argument("--grid", choices=[grid.value for grid in Grid], default="square", help="default square")
    parser.add_argument("--window", type=int, default=3, help="window size, odd (default 3)")
    parser.add_argument("--rows", type=int, help="with --cols: the size of the map")
    parser.add_argument("--cols", type=int, help="with --rows: the size of the map")
    parser.add_argument("--aspect", help="without a size: width:height of the image to fill (default: the projector's)")
    parser.add_argument("--method", choices=["paper", "best"], default="best",
                        help="best: the strongest search (default); paper: section II.B as written")  # fmt: skip
    parser.add_argument("--reading", choices=[reading.value for reading in Reading], default="strict",
                        help="own rotations: base: any, strict: differ (default), selfdist: HAMMING apart")  # fmt: skip
    parser.add_argument("--no-rotation-invariance", action="store_true", help="the camera's roll is known")
    parser.add_argument("--epipolar-band", type=int, metavar="ROWS",
                        help="windows more than ROWS apart may be equal: epipolar lines tell them apart")  # fmt: skip
    parser.add_argument("--seed", type=int, default=0, help="of the random choices; the same seed gives the same map")
    parser.add_argument("--time-limit", type=float, default=10.0, help="of the search in s (default 10)")
    parser.add_argument("--projector", type=size, default=(1024, 768), metavar="WxH", help="default 1024x768")
    parser.add_argument(
        "--monochrome", action="store_true", help="letters for a camera without colour: shapes and intensities"
    )
    parser.add_argument("--output", type=Path, required=True, help="the pattern file (YAML)")
    return parser


def _run(arguments: argparse.Namespace) -> None:
    from pattern_gen.search import search_map

    request = Request(
        alphabet=arguments.letters,
        h=arguments.hamming,
        grid=Grid(arguments.grid),
        window=arguments.window,
        reading=Reading(arguments.reading),
        invariant=not arguments.no_rotation_invariance,
        band=arguments.epipolar_band,
        seed=arguments.seed,
    )
    projector = arguments.projector
    aspect = projector[0] / projector[1] if arguments.aspect is None else parse_aspect(arguments.aspect)
    letters = choose_letters(arguments.letters, monochrome=arguments.monochrome)
    line = ProgressLine(arguments.time_limit)
    try:
        found = search_map(
            request,
            rows=arguments.rows,
            cols=arguments.cols,
            aspect=aspect,
            method=arguments.method,
            time_limit=arguments.time_limit,
            report=line,
        )
    finally:
        line.close()
    pattern = pattern_of(found.symbols, request, letters, projector)
    pattern.save(arguments.output)
    ending = ", the search space is exhausted: no larger map of this kind exists" if found.exhausted else ""
    print(
        f"{arguments.output}: {pattern.rows}x{pattern.cols} {pattern.grid.value} map, {pattern.window_count} codes, "
        f"{pattern.alphabet} letters, distance {pattern.min_hamming}, id {pattern.pattern_id}, "
        f"found in {found.seconds:.2f} s"
        f"{ending}"
    )
    if pattern.pitch < 3.0:
        print(
            f"warning: spots only {pattern.pitch:.2f} px apart on a projector of {projector[0]}x{projector[1]}; "
            "give --projector a larger size or ask for a smaller map",
            file=sys.stderr,
        )


def main() -> int:
    """Entry point."""
    parser = _parser()
    arguments = parser.parse_args()
    if (arguments.rows is None) != (arguments.cols is None):
        parser.error("give both --rows and --cols, or neither")
    if arguments.rows is not None and arguments.aspect is not None:
        parser.error("--aspect goes without --rows and --cols")
    if arguments.time_limit <= 0:
        parser.error(f"--time-limit {arguments.time_limit} must be above 0")
    return run_command(parser, _run)


if __name__ == "__main__":
    sys.exit(main())
