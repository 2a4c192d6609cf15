"""Command calibrate_procam: camera and projector from captures of a Gray code sequence on a chessboard."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pattern_gen.gray_code import Arrangement
from sl_calibration.camera_calibration import name_odd_view, rms
from sl_calibration.chessboard import Board, BoardNotFoundError, parse_size
from sl_calibration.commands.calibrate_camera import parameter_line
from sl_calibration.commands.shared import images_in, read_image
from sl_calibration.gray_code import Capture, CaptureError, make_capture
from sl_calibration.grid_files import save_procam_calibration
from sl_calibration.intrinsics import MODELS
from sl_calibration.projector_calibration import ProcamCalibration, ProcamOptions, calibrate_procam
from sl_calibration.projector_corners import board_in_capture
from sl_calibration.virtual_screen import virtual_screen
from sl_common import transforms
from sl_common.calibration_files import load_hand_eye
from sl_common.cameras import CameraModel
from sl_common.commands import make_parser, progress, run_command
from sl_common.errors import InvalidInputError

EXAMPLE = """\
  ros2 run sl_calibration calibrate_procam --board 9x7 --square 0.075 --projector 1024x768 --output calibration
  capture_*
Each folder holds the photographs of one sequence in the order of their names: column bits, most significant first, each
followed by its inverse, row bits likewise, then (optionally) all white and all black. Two captures or more, better
five, the board tilted differently in each. Writes camera.yaml, projector.yaml and camera_from_projector.yaml; with
--flange also projector_pose.yaml, by the hand_eye.yaml that lies in the calibration folder."""


def _parser() -> argparse.ArgumentParser:
    """Return the command's argument parser."""
    p = make_parser("sl_calibration calibrate_procam", __doc__ or "", EXAMPLE)
    p.add_argument("--board", required=True, metavar="CxR", help="inner corners of the chessboard, such as 9x7")
    p.add_argument("--square", required=True, type=float, metavar="M", help="side of a square in metres")
    p.add_argument("--projector", required=True, metavar="WxH", help="projector's resolution, such as 1024x768")
    p.add_argument("--output", required=True, type=Path, metavar="DIR", help="calibration folder to write")
    p.add_argument("--camera-model", default="plumb_bob", choices=MODELS, help="distortion (default: plumb_bob)")
    p.add_argument("--projector-model", default="plumb_bob", choices=MODELS, help="distortion (default: plumb_bob)")
    p.add_argument(
        "--arrangement",
        default="reflected",
        choices=[a.value for a in Arrangement],
        help="order of the code words (default: reflected)",
    )
    p.add_argument(
        "--start",
        type=float,
        nargs=3,
        metavar=("F", "CX", "CY"),
        help="a guess of the projector's focal length and principal point in px; never needed",
    )
    p.add_argument(
        "--flange",
        type=float,
        nargs=7,
        metavar=("X", "Y", "Z", "QX", "QY", "QZ", "QW"),
        help="pose of the flange in the base [m] at which the arm held the camera during all captures",
    )
    p.add_argument("captures", nargs="+", type=Path, metavar="CAPTURE_DIR", help="folders, one for each board pose")
    return p


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    return run_command(_parser(), _run, arguments)


def _run(args: argparse.Namespace) -> None:
    board = Board(*parse_size(args.board, "board"), args.square)
    hand_eye = load_hand_eye(args.output) if args.flange else None
    projector = parse_size(args.projector, "projector")
    start = None
    if args.start:
        f, cx, cy = args.start
        start = CameraModel(*projector, np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]]))
    in_camera, in_projector = [], []
    size: tuple[int, int] | None = None
    for folder in progress(args.captures, "captures"):
        capture = load_capture(folder, projector, Arrangement(args.arrangement))
        own = (capture.white.shape[1], capture.white.shape[0])
        if size is not None and own != size:
            raise InvalidInputError(
                f"{folder}: images of {own[0]}x{own[1]}, those of the captures before it are {size[0]}x{size[1]}"
            )
        size = own
        corners, mapped = correspond(capture, folder, board)
        in_camera.append(corners)
        in_projector.append(mapped)
    assert size is not None
    options = ProcamOptions(camera_model=args.camera_model, projector_model=args.projector_model, start=start)
    names = [folder.name for folder in args.captures]
    with name_odd_view(names):
        result = calibrate_procam(np.array(in_camera), np.array(in_projector), board, size, projector, options)
    print(summary(result, names))
    flange = transforms.from_quaternion(args.flange[:3], args.flange[3:]) if args.flange else None
    for path in save_procam_calibration(args.output, result, base_from_flange=flange, hand_eye=hand_eye):
        print(f"wrote {path}")


def load_capture(folder: Path, projector: tuple[int, int], arrangement: Arrangement) -> Capture:
    """Read the images of a folder as one capture. Raises CaptureError or InvalidInputError naming folder and image."""
    files = images_in(folder)
    try:
        return make_capture([read_image(f) for f in files], [f.name for f in files], projector, arrangement)
    except CaptureError as error:
        raise CaptureError(f"{folder}: {error}") from None


def correspond(capture: Capture, folder: Path, board: Board) -> tuple[np.ndarray, np.ndarray]:
    """Return the board's corners (N, 2) in the camera and (N, 2) in the projector. Errors name the folder."""
    try:
        return board_in_capture(capture, board)
    except BoardNotFoundError as error:
        hint = f": wrong board size? Give --board {error.found[0]}x{error.found[1]}" if error.found else ""
        raise InvalidInputError(f"{folder}: {error}{hint}") from None
    except CaptureError as error:
        raise CaptureError(f"{folder}: {error}") from None


def summary(result: ProcamCalibration, names: Sequence[str]) -> str:
    """Return the result in lines for people."""
    per_view = [
        (rms(camera), rms(projector), left_camera, left_projector, rigid)
        for camera, projector, left_camera, left_projector, rigid in zip(
            result.camera_residuals,
            result.projector_residuals,
            result.left_out_camera,
            result.left_out_projector,
            result.rigid_fit,
            strict=True,
        )
    ]
    worst = int(np.nanargmax([row[1] for row in per_view]))
    baseline = 1e3 * np.linalg.norm(result.camera_from_projector[:3, 3])
    lines = ["view: training camera, projector | left out camera, projector [px RMS] | rigid fit of the board [mm RMS]"]
    for name, row in zip(names, per_view, strict=True):
        lines.append(f"  {name}: {row[0]:.3f}, {row[1]:.3f} | {row[2]:.3f}, {row[3]:.3f} | {row[4]:.3f}")
    center = result.projector.matrix[:2, 2]
    screen = virtual_screen(result.projector.width, result.projector.height, center)
    lines += [
        f"training: camera {rms(result.camera_residuals):.3f} px, projector {rms(result.projector_residuals):.3f} px,"
        f" joint {result.joint_rms:.3f} px RMS; {result.rejected} corners rejected",
        f"left out: camera {np.nanmean(result.left_out_camera):.3f} px, projector"
        f" {np.nanmean(result.left_out_projector):.3f} px on average",
        f"rigid fit of the board: {np.nanmean(result.rigid_fit):.3f} mm on average; baseline {baseline:.1f} mm",
        f"worst view: {names[worst]}",
        f"camera: {parameter_line(result.camera_parameters)}",
        f"projector: {parameter_line(result.projector_parameters)}",
        f"virtual screen: {screen.width:.0f}x{screen.height:.0f}, grown by {screen.growth_x:.2f} and"
        f" {screen.growth_y:.2f}",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
