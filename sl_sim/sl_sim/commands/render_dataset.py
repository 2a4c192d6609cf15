"""Render single-shot images of random scenes with exact truth."""

import argparse
import sys
from pathlib import Path

import numpy as np

from pattern_gen import Pattern, default_pattern
from sl_common.commands import UsageError, make_parser, progress, run_command
from sl_common.errors import StructuredLightError
from sl_sim import scenes
from sl_sim.dataset import CAMERAS, render_shot
from sl_sim.dataset_files import refuse_used, write_image, write_truth
from sl_sim.effects import EFFECTS


def _parser() -> argparse.ArgumentParser:
    parser = make_parser(
        "sl_sim render_dataset",
        "Render single-shot images of random scenes with exact truth.",
        "  ros2 run sl_sim render_dataset --output held_out --count 40 --seed 7 --scenes bust,boxes --effects lab,dim",
    )
    listing = lambda names: ", ".join(names)  # noqa: E731
    parser.add_argument(
        "--output", required=True, type=Path, metavar="DIR", help="folder to write images/, truth/ and pattern.yaml to"
    )
    parser.add_argument("--count", type=int, default=20, help="number of images (default 20)")
    parser.add_argument("--seed", type=int, default=0, help="image k uses seed SEED * 10000 + k (default 0)")
    parser.add_argument(
        "--pattern", type=Path, metavar="FILE.yaml", help="pattern to project (default: the shipped 44x58)"
    )
    parser.add_argument(
        "--scenes", default="all", help=f"comma-separated, taken in turn: {listing(scenes.NAMES)} (default all)"
    )
    parser.add_argument(
        "--effects", default="all", help=f"comma-separated, drawn at random: {listing(EFFECTS)} (default all)"
    )
    parser.add_argument(
        "--cameras", default="vga,vga_barrel,hd", help=f"comma-separated, drawn at random: {listing(CAMERAS)}"
    )
    parser.add_argument(
        "--oblique", type=float, default=60.0, help="largest angle of view from the object's front [deg] (default 60)"
    )
    parser.add_argument("--near", type=float, default=0.4, help="least distance of the camera [m] (default 0.4)")
    parser.add_argument("--far", type=float, default=0.95, help="largest distance of the camera [m] (default 0.95)")
    return parser


def _choice(text: str, known: tuple[str, ...], what: str) -> list[str]:
    names = list(known) if text == "all" else [name.strip() for name in text.split(",")]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise StructuredLightError(f"unknown {what} {', '.join(unknown)}: use {', '.join(known)}")
    return names


def _run(args: argparse.Namespace) -> None:
    if args.count < 1 or not 0 < args.near <= args.far or not 0 <= args.oblique < 85:
        raise UsageError("--count must be at least 1, 0 < --near <= --far, 0 <= --oblique < 85")
    names = _choice(args.scenes, scenes.NAMES, "scenes")
    effects = _choice(args.effects, tuple(EFFECTS), "effects")
    cameras = _choice(args.cameras, CAMERAS, "cameras")
    pattern = Pattern.load(args.pattern) if args.pattern else default_pattern()
    refuse_used(args.output)
    args.output.mkdir(parents=True, exist_ok=True)
    pattern.save(args.output / "pattern.yaml")
    for k in progress(range(args.count), "images"):
        seed = args.seed * 10000 + k
        rng = np.random.default_rng([seed, 1])
        shot = render_shot(
            pattern,
            scene=names[k % len(names)],
            camera=str(rng.choice(cameras)),
            effects=str(rng.choice(effects)),
            seed=seed,
            distance=(args.near, args.far),
            oblique=args.oblique,
        )
        write_truth(args.output, shot.name, shot.arrays, shot.meta)
        write_image(args.output, shot.name, shot.image)
    print(f"{args.count} images in {args.output}")


def main(arguments: list[str] | None = None) -> int:
    """Entry point of `ros2 run sl_sim render_dataset`; returns the exit code."""
    return run_command(_parser(), _run, arguments)


if __name__ == "__main__":
    sys.exit(main())
