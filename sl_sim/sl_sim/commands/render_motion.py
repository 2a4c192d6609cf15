"""Render a robot motion for self-calibration: images, reported flange poses, and exact truth."""

import argparse
import sys
from pathlib import Path

from pattern_gen import Pattern, default_pattern
from sl_common.commands import UsageError, make_parser, progress, run_command
from sl_common.errors import StructuredLightError
from sl_sim import scenes
from sl_sim.cell import Cell, CellSettings
from sl_sim.dataset_files import refuse_used, write_image, write_json, write_truth
from sl_sim.effects import EFFECTS
from sl_sim.motion_set import motion_file, motion_views


def _parser() -> argparse.ArgumentParser:
    parser = make_parser(
        "sl_sim render_motion",
        "Render a robot motion for self-calibration: images, reported flange poses, and exact truth.",
        "  ros2 run sl_sim render_motion --output motion --views 14 --scene boxes --seed 3",
    )
    parser.add_argument(
        "--output",
        required=True,
        type=Path,
        metavar="DIR",
        help="folder for images/, truth/, motion.json, pattern.yaml",
    )
    parser.add_argument("--views", type=int, default=14, help="number of poses (default 14)")
    parser.add_argument("--scene", default="boxes", help=f"one of {', '.join(scenes.NAMES)} (default boxes)")
    parser.add_argument("--seed", type=int, default=0, help="varies scene, mounting, poses and noise (default 0)")
    parser.add_argument("--effects", default="lab", help=f"one of {', '.join(EFFECTS)} (default lab)")
    parser.add_argument(
        "--pattern", type=Path, metavar="FILE.yaml", help="pattern to project (default: the shipped 44x58)"
    )
    parser.add_argument(
        "--pers", type=float, default=1.1, help="Pers coefficient of the lens in focal lengths, 0 = none (default 1.1)"
    )
    parser.add_argument(
        "--noise-mm", type=float, default=0.1, help="noise of the reported position per axis (default 0.1)"
    )
    parser.add_argument(
        "--noise-deg", type=float, default=0.02, help="noise of the reported orientation per axis (default 0.02)"
    )
    parser.add_argument(
        "--oblique", type=float, default=40.0, help="largest angle of view from the object's front [deg] (default 40)"
    )
    return parser


def _run(args: argparse.Namespace) -> None:
    if args.views < 1 or args.pers < 0 or args.noise_mm < 0 or args.noise_deg < 0 or not 0 <= args.oblique < 85:
        raise UsageError("--views must be at least 1, --pers and the noise not negative, 0 <= --oblique < 85")
    if args.effects not in EFFECTS:
        raise StructuredLightError(f"unknown effects '{args.effects}': use one of {', '.join(EFFECTS)}")
    refuse_used(args.output)
    pattern = Pattern.load(args.pattern) if args.pattern else default_pattern()
    settings = CellSettings(
        scene=args.scene, seed=args.seed, pers=args.pers,
        projector_width=pattern.projector_width, projector_height=pattern.projector_height,
    )  # fmt: skip
    cell = Cell(settings)
    views, names = [], []
    taken = motion_views(
        cell, pattern, EFFECTS[args.effects], args.views,
        noise_mm=args.noise_mm, noise_deg=args.noise_deg, oblique=args.oblique, seed=args.seed,
    )  # fmt: skip
    for k, view in enumerate(progress(taken, "views", total=args.views)):
        write_truth(args.output, f"{k:03d}", view.arrays)
        write_image(args.output, f"{k:03d}", view.image)
        views.append(view)
        names.append(f"images/{k:03d}.png")
    pattern.save(args.output / "pattern.yaml")
    write_json(args.output / "motion.json", motion_file(cell, views, names, args.noise_mm, args.noise_deg))
    print(f"{args.views} views in {args.output}")


def main(arguments: list[str] | None = None) -> int:
    """Entry point of `ros2 run sl_sim render_motion`; returns the exit code."""
    return run_command(_parser(), _run, arguments)


if __name__ == "__main__":
    sys.exit(main())
