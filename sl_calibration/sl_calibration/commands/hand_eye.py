"""Command hand_eye: the camera's pose on the flange from poses of the hand and of a target seen by the camera."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sl_calibration.grid_files import save_hand_eye_calibration
from sl_calibration.hand_eye import HandEye, HandEyeOptions, calibrate_hand_eye
from sl_calibration.pose_stream import load_poses
from sl_common.commands import make_parser, run_command
from sl_common.transforms import to_quaternion

EXAMPLE = """\
  ros2 run sl_calibration hand_eye --hand hand.csv --eye eye.csv --output calibration/hand_eye.yaml
Rows of both files: t,x,y,z,qx,qy,qz,qw [s, m], header optional. hand: base_from_hand. eye: camera_from_target, or its
inverse, which is found out. Single poses with equal stamps, or two streams at any rates: the hand's is interpolated and
the time offset between them estimated. Turn the hand by 30 deg and more about two axes; 15 poses or more."""


def _parser() -> argparse.ArgumentParser:
    """Return the command's argument parser."""
    p = make_parser("sl_calibration hand_eye", __doc__ or "", EXAMPLE)
    p.add_argument("--hand", required=True, type=Path, metavar="HAND.csv", help="poses of the hand in the base")
    p.add_argument("--eye", required=True, type=Path, metavar="EYE.csv", help="poses of the target in the camera")
    p.add_argument("--output", required=True, type=Path, metavar="FILE.yaml", help="file to write")
    p.add_argument(
        "--eye-poses",
        default="auto",
        choices=("auto", "camera_from_target", "target_from_camera"),
        help="what the eye's poses are (default: auto, the one that fits)",
    )
    p.add_argument(
        "--max-offset",
        type=float,
        default=0.5,
        metavar="S",
        help="largest time offset looked for; 0: none (default: 0.5)",
    )
    p.add_argument("--reject-outliers", action="store_true", help="leave outliers out instead of stopping at them")
    return p


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    return run_command(_parser(), _run, arguments)


def _run(args: argparse.Namespace) -> None:
    inverted = None if args.eye_poses == "auto" else args.eye_poses == "target_from_camera"
    options = HandEyeOptions(max_offset=args.max_offset, reject_outliers=args.reject_outliers)
    result = calibrate_hand_eye(load_poses(args.hand), load_poses(args.eye), options, eye_inverted=inverted)
    print(summary(result))
    print(f"wrote {save_hand_eye_calibration(args.output, result)}")


def _statistics(position: np.ndarray, rotation: np.ndarray) -> str:
    return (
        f"mean {1e3 * position.mean():.2f} mm {np.degrees(rotation.mean()):.3f} deg,"
        f" RMS {1e3 * _rms(position):.2f} mm {np.degrees(_rms(rotation)):.3f} deg"
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


def summary(result: HandEye) -> str:
    """Return the result in lines for people."""
    worst = int(np.argmax(result.left_out_position))
    limit = 1.96 * np.sqrt(np.diag(result.covariance))
    translation, quaternion = to_quaternion(result.flange_from_camera)
    lines = [f"{len(result.rows)} poses; distance of the target from its one pose in the base:"]
    for name, (position, rotation) in result.closed_forms.items():
        lines.append(f"  {name + ':':12s}mean {1e3 * position:.2f} mm {np.degrees(rotation):.3f} deg")
    lines += [
        f"  training:   {_statistics(result.position_error, result.rotation_error)}",
        f"  left out:   {_statistics(result.left_out_position, result.left_out_rotation)}",
        f"worst sample left out: line {result.rows[worst]} of the eye's file,"
        f" {1e3 * result.left_out_position[worst]:.2f} mm {np.degrees(result.left_out_rotation[worst]):.2f} deg",
    ]
    if len(result.rejected_rows):
        lines.append(f"rejected as outliers: lines {', '.join(str(row) for row in result.rejected_rows)}")
    if result.eye_inverted:
        lines.append("the eye's poses are those of the camera in the target (target_from_camera)")
    if result.offset_estimated:
        lines.append(f"time offset: an eye pose stamped t belongs to the hand at t {1e3 * result.time_offset:+.1f} ms")
    lines += [
        "flange_from_camera: position "
        + ", ".join(f"{1e3 * x:.2f} +- {1e3 * s:.2f}" for x, s in zip(translation, limit[:3], strict=True))
        + " mm; quaternion xyzw "
        + ", ".join(f"{q:.5f}" for q in quaternion)
        + "; rotation +- "
        + ", ".join(f"{np.degrees(s):.3f}" for s in limit[3:])
        + " deg (95 %)",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
