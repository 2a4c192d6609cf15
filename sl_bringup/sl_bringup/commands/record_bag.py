"""``ros2 run sl_bringup record_bag``: a small bag of the chain's input, with its truth, from the simulated cell."""

import argparse
import shutil
import sys
import tempfile
from pathlib import Path

from sl_bringup.errors import BagError
from sl_common.commands import UsageError, make_parser, run_command

_EXAMPLE = """  ros2 run sl_bringup record_bag --scene wavy --seed 1 --output bags/wavy

The folder then holds bag/ (MCAP), calibration/ (exact), truth.json and spots.npy.
The same arguments give the same messages."""


def _parser() -> argparse.ArgumentParser:
    parser = make_parser(
        "sl_bringup record_bag",
        "Render a short motion of the simulated cell and write what the nodes would receive as a bag.",
        _EXAMPLE,
    )
    parser.add_argument("--scene", default="wavy", help="scene of the cell (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of scene, mounting and noise (default: %(default)s)")
    parser.add_argument("--frames", type=int, default=5, help="number of images (default: %(default)s)")
    parser.add_argument("--output", type=Path, required=True, help="folder to create")
    return parser


def _run(options: argparse.Namespace) -> None:
    if options.frames < 2:
        raise UsageError(f"--frames {options.frames} must be at least 2")
    _record(options.output, options.scene, options.seed, options.frames)
    size = sum(p.stat().st_size for p in options.output.rglob("*") if p.is_file())
    print(f"{options.output}: {options.frames} images, {size / 1e6:.1f} MB")


def _record(output: Path, scene: str, seed: int, frames: int) -> None:
    """Write the folder whole or not at all."""
    if output.exists():
        raise BagError(f"{output} exists already: remove it or choose another --output")
    from sl_bringup.bag.scripted import Script, record  # the simulation loads only when it is needed

    output.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(dir=output.parent, prefix=f".{output.name}-"))
    try:
        record(temporary, Script(scene=scene, seed=seed, frames=frames))
        temporary.chmod(0o755)
        temporary.rename(output)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def main(arguments: list[str] | None = None) -> int:
    """Run the command."""
    return run_command(_parser(), _run, arguments)


if __name__ == "__main__":
    sys.exit(main())
