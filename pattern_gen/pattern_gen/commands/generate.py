"""`generate`: search for a map and write the pattern file."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from pattern_gen.commands.cli import ProgressLine, size
from pattern_gen.generation import pattern_of, request_of
from pattern_gen.letters import choose_letters
from pattern_gen.pattern import Grid, Pattern
from pattern_gen.search_request import Reading, Request, parse_aspect
from sl_common.commands import make_parser, run_command

EXAMPLE = """\
  ros2 run pattern_gen generate --letters 6 --hamming 3 --rows 44 --cols 58 --output pattern.yaml
  ros2 run pattern_gen generate --letters 6 --hamming 3 --aspect 4:3 --time-limit 30 --output large.yaml
  ros2 run pattern_gen generate --enlarge pattern.yaml --rows 48 --cols 64 --output larger.yaml
  ros2 run pattern_gen generate --letters 4 --hamming 3 --grid hexagonal --monochrome --output hexagonal.yaml
"""


def _parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    parser = make_parser(
        "pattern_gen generate", "Generate a rotation-invariant map of letters in which all windows differ.", EXAMPLE
    )
    parser.add_argument("--letters", type=int, help="size of the alphabet, 2 to 36")
    parser.add_argument("--hamming", type=int, help="least number of differing spots of two windows (default 1)")
    parser.add_argument("--grid", choices=[grid.value for grid in Grid], help="default square")
    parser.add_argument("--window", type=int, help="window size, odd (default 3)")
    parser.add_argument("--enlarge", type=Path, metavar="FILE",
                        help="a pattern file: its map becomes the top left part, its letters are kept")  # fmt: skip
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
    parser.add_argument(
        "--projector", type=size, metavar="WxH", help="default 1024x768, or that of the enlarged pattern"
    )
    parser.add_argument(
        "--monochrome", action="store_true", help="letters for a camera without colour: shapes and intensities"
    )
    parser.add_argument("--no-cache", action="store_true", help="search even if this map was found before")
    parser.add_argument("--output", type=Path, required=True, help="the pattern file (YAML)")
    return parser


def _request(arguments: argparse.Namespace, base: Pattern | None) -> Request:
    if base is not None:
        return request_of(base, Reading(arguments.reading), arguments.seed)
    return Request(
        alphabet=arguments.letters,
        h=1 if arguments.hamming is None else arguments.hamming,
        grid=Grid(arguments.grid or "square"),
        window=3 if arguments.window is None else arguments.window,
        reading=Reading(arguments.reading),
        invariant=not arguments.no_rotation_invariance,
        band=arguments.epipolar_band,
        seed=arguments.seed,
    )


def _run(arguments: argparse.Namespace) -> None:
    from pattern_gen.assignment import assign_letters
    from pattern_gen.map_cache import cached_search

    base = None if arguments.enlarge is None else Pattern.load(arguments.enlarge)
    request = _request(arguments, base)
    own_projector = (1024, 768) if base is None else (base.projector_width, base.projector_height)
    projector = arguments.projector or own_projector
    aspect = projector[0] / projector[1] if arguments.aspect is None else parse_aspect(arguments.aspect)
    letters = base.letters if base is not None else choose_letters(request.alphabet, monochrome=arguments.monochrome)
    line = ProgressLine(arguments.time_limit)
    try:
        found = cached_search(
            request,
            rows=arguments.rows,
            cols=arguments.cols,
            aspect=aspect,
            method=arguments.method,
            time_limit=arguments.time_limit,
            start=None if base is None else base.symbols,
            cache=not arguments.no_cache,
            report=line,
        )
    finally:
        line.close()
    if base is None:
        letters = assign_letters(found.symbols, letters, request)
    pattern = pattern_of(found.symbols, request, letters, projector)
    pattern.save(arguments.output)
    ending = ", the search space is exhausted: no larger map of this kind exists" if found.exhausted else ""
    ending += ", from the cache" if found.cached else ""
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


def _check_enlarge(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    if arguments.enlarge is None:
        if arguments.letters is None:
            parser.error("give --letters, or --enlarge with a pattern file")
        return
    said = ["letters", "hamming", "grid", "window", "epipolar_band", "monochrome", "no_rotation_invariance"]
    for name in said:
        if getattr(arguments, name) not in (None, False):
            parser.error(f"--{name.replace('_', '-')} goes without --enlarge: the file says it")


def main() -> int:
    """Entry point."""
    parser = _parser()
    arguments = parser.parse_args()
    if (arguments.rows is None) != (arguments.cols is None):
        parser.error("give both --rows and --cols, or neither")
    _check_enlarge(parser, arguments)
    if arguments.rows is not None and arguments.aspect is not None:
        parser.error("--aspect goes without --rows and --cols")
    if arguments.time_limit <= 0:
        parser.error(f"--time-limit {arguments.time_limit} must be above 0")
    return run_command(parser, _run)


if __name__ == "__main__":
    sys.exit(main())
