"""Command calibrate_camera: a camera's intrinsics from photographs of a chessboard."""

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sl_calibration.camera_calibration import (
    CameraCalibration,
    CameraOptions,
    calibrate_camera,
    name_odd_view,
    rms,
    root_mean_square,
    same_views,
)
from sl_calibration.chessboard import Board, BoardNotFoundError, detect_corners, parse_size
from sl_calibration.commands.shared import read_image
from sl_calibration.grid_files import save_camera_calibration
from sl_calibration.intrinsics import MODELS
from sl_common.commands import make_parser, progress, run_command
from sl_common.errors import InvalidInputError

EXAMPLE = """\
  ros2 run sl_calibration calibrate_camera --board 8x6 --square 0.03 --output calibration/camera.yaml images/*.jpg
The board is given by its inner corners. 10 images or more, the board tilted differently in each and reaching into the
image's corners. The left-out error is that of views that the calibration did not see: it chooses the distortion
model."""


def _parser() -> argparse.ArgumentParser:
    """Return the command's argument parser."""
    p = make_parser("sl_calibration calibrate_camera", __doc__ or "", EXAMPLE)
    p.add_argument("--board", required=True, metavar="CxR", help="inner corners of the chessboard, such as 8x6")
    p.add_argument("--square", required=True, type=float, metavar="M", help="side of a square in metres")
    p.add_argument("--model", default="auto", choices=("auto", *MODELS), help="distortion model (default: auto)")
    p.add_argument("--name", default="camera", help="camera_name in the file (default: camera)")
    p.add_argument("--output", required=True, type=Path, metavar="FILE.yaml", help="camera_info file to write")
    p.add_argument("images", nargs="+", type=Path, metavar="IMAGE", help="photographs of the board")
    return p


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    return run_command(_parser(), _run, arguments)


def _run(args: argparse.Namespace) -> None:
    board = Board(*parse_size(args.board, "board"), args.square)
    names, corners, (width, height), missing = find_boards(args.images, board)
    for name, reason in missing:
        print(f"{name}: {reason}; skipped", file=sys.stderr)
    seen = np.array(corners).reshape(len(corners), -1, 2)
    twins = same_views(seen)
    for k, earlier in twins.items():
        print(f"{names[k]}: shows the board where {names[earlier]} does; skipped", file=sys.stderr)
    different = [k for k in range(len(names)) if k not in twins]
    names, seen = [names[k] for k in different], seen[different]
    with name_odd_view(names):
        result = calibrate_camera(seen, board, width, height, CameraOptions(args.model))
    print(summary(result, names, args.model))
    print(f"wrote {save_camera_calibration(args.output, result, name=args.name)}")


def find_boards(
    paths: Sequence[Path], board: Board
) -> tuple[list[str], list[np.ndarray], tuple[int, int], list[tuple[str, str]]]:
    """Detect the board in images.

    Returns:
        Names and corners (N, 2) of the images with the board, the images' (width, height), and (name, reason) of the
        rest.

    Raises:
        InvalidInputError: no image can be used, images of several sizes, or a board of another size in most of them.
    """
    names, corners, missing = [], [], []
    size: tuple[int, int] | None = None
    others: Counter[tuple[int, int]] = Counter()
    for path in progress(paths, "finding corners"):
        image = read_image(path)
        own = (image.shape[1], image.shape[0])
        if size is not None and own != size:
            raise InvalidInputError(
                f"{path} is {own[0]}x{own[1]}, the images before it are {size[0]}x{size[1]}: all must come from one"
                f" camera"
                " at one resolution; leave it out"
            )
        size = own
        try:
            corners.append(detect_corners(image, board))
            names.append(path.name)
        except BoardNotFoundError as error:
            missing.append((path.name, str(error)))
            if error.found is not None and min(error.found) >= 3:
                others[error.found] += 1
    assert size is not None
    if others and others.most_common(1)[0][1] > len(names):
        found, number = others.most_common(1)[0]
        raise InvalidInputError(
            f"wrong board size: --board {board} is in {len(names)} of {len(paths)} images, but {number} show"
            f" {found[0]}x{found[1]} inner corners; give --board {found[0]}x{found[1]} if that is the board"
        )
    if not names:
        raise InvalidInputError(f"no chessboard of {board} inner corners found in any of {len(paths)} images")
    return names, corners, size, missing


def summary(result: CameraCalibration, names: Sequence[str], asked: str) -> str:
    """Return the result in lines for people."""
    per_view = result.per_view
    worst, worst_left_out = int(np.nanargmax(per_view)), int(np.nanargmax(result.left_out))
    lines = [f"{len(names)} views, {np.isfinite(result.residuals[..., 0]).sum()} corners ({result.rejected} rejected)"]
    for name, (training, left_out) in result.candidates.items():
        chosen = "  <- chosen" if name == result.parametrisation.model and asked == "auto" else ""
        lines.append(f"model {name:10s} training {training:.3f} px, left-out {left_out:.3f} px{chosen}")
    lines += [
        f"camera: training {rms(result.residuals):.3f} px RMS, left-out {root_mean_square(result.left_out):.3f} px RMS",
        f"worst view: {names[worst]} {per_view[worst]:.3f} px;"
        f" left out: {names[worst_left_out]} {result.left_out[worst_left_out]:.3f} px",
        parameter_line(result.parameters),
    ]
    return "\n".join(lines)


def parameter_line(parameters: dict[str, dict[str, float]]) -> str:
    """Return values with their 95 % limits in one line."""
    parts = []
    for name, entry in parameters.items():
        value, limit = entry["value"], 1.96 * entry["sigma"]
        parts.append(f"{name} {value:.2f} +- {limit:.2f}" if name[0] in "fc" else f"{name} {value:.4f} +- {limit:.4f}")
    return ", ".join(parts) + " (95 %; px)"


if __name__ == "__main__":
    sys.exit(main())
