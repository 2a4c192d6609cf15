"""`export`: the projector image and the arrays of a pattern file."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from pattern_gen.errors import PatternError
from pattern_gen.pattern import Pattern
from sl_common.commands import make_parser, run_command
from sl_common.files import atomic_path


def _parser() -> argparse.ArgumentParser:
    """The command's arguments."""
    parser = make_parser(
        "pattern_gen export",
        "Write a pattern as an image and as numpy arrays.",
        "  ros2 run pattern_gen export pattern.yaml --image pattern.png --npz pattern.npz\n\n"
        "The npz holds image (H,W,3 uint8 RGB), symbols (rows,cols) and centers (rows,cols,2: u, v in projector px).",
    )
    parser.add_argument("file", type=Path, help="the pattern file (YAML)")
    parser.add_argument("--image", type=Path, help="projector image, lossless: .png, .tif or .bmp")
    parser.add_argument("--npz", type=Path, help="arrays")
    parser.add_argument("--spot-diameter", type=float, metavar="PX", help="instead of the file's, in projector px")
    return parser


def _write_image(path: Path, image: np.ndarray) -> None:
    import cv2

    if path.suffix.lower() not in (".png", ".tif", ".tiff", ".bmp"):
        raise PatternError(f"{path}: the image must be .png, .tif or .bmp, so that no colour is lost")
    with atomic_path(path) as temporary:
        if not cv2.imwrite(str(temporary), image[..., ::-1]):
            raise PatternError(f"{path}: the image could not be written")


def _run(arguments: argparse.Namespace) -> None:
    pattern = Pattern.load(arguments.file)
    image = pattern.render(arguments.spot_diameter)
    if arguments.image is not None:
        _write_image(arguments.image, image)
        print(f"{arguments.image}: {pattern.projector_width}x{pattern.projector_height} image")
    if arguments.npz is not None:
        with atomic_path(arguments.npz) as temporary, temporary.open("wb") as stream:
            np.savez_compressed(stream, image=image, symbols=pattern.symbols, centers=pattern.centers)
        print(f"{arguments.npz}: image, symbols, centers of {pattern.rows}x{pattern.cols} spots")


def main() -> int:
    """Entry point."""
    parser = _parser()
    arguments = parser.parse_args()
    if arguments.image is None and arguments.npz is None:
        parser.error("give --image, --npz or both")
    return run_command(parser, _run)


if __name__ == "__main__":
    sys.exit(main())
