"""Command self_calibrate: projector, hand-eye transform and all dots from known robot motion, without a grid."""

import argparse
import math
import sys
from collections.abc import Sequence

import numpy as np
from tqdm import tqdm

from pattern_gen import Pattern
from sl_calibration.self_calibration.calibrate import SelfCalibrationOptions, self_calibrate
from sl_calibration.self_calibration.files import save
from sl_calibration.self_calibration.inputs import Motion, load_motion, load_views
from sl_calibration.self_calibration.noise_model import RobotNoise
from sl_calibration.self_calibration.result import SelfCalibration
from sl_common.commands import make_parser, run_command

EXAMPLE = """\
  ros2 run sl_decoder decode_images --pattern pattern.yaml --output decoded images/*.png
  ros2 run sl_calibration self_calibrate --motion motion.json --correspondences decoded --pattern pattern.yaml \\
      --output calibration
The motion file gives the camera's intrinsics and for every image the flange pose base_from_flange (4x4, metres).
Projector and scene must stand still; 10 views or more, turned by 20 deg or more about two axes, of a scene that is not
flat."""

_STAGES = 7


def _parser() -> argparse.ArgumentParser:
    """Return the command's argument parser."""
    p = make_parser("sl_calibration self_calibrate", __doc__ or "", EXAMPLE)
    p.add_argument("--motion", required=True, help="JSON with the camera and each image's flange pose")
    p.add_argument("--correspondences", required=True, help="folder with NAME.csv as decode_images writes it")
    p.add_argument("--pattern", required=True, help="pattern file (YAML) that was projected")
    p.add_argument("--output", required=True, help="calibration folder to write")
    p.add_argument(
        "--min-confidence", type=float, default=0.5, help="leave out dots of lower confidence (default: 0.5)"
    )
    p.add_argument(
        "--robot-noise",
        type=float,
        nargs=2,
        metavar=("MM", "DEG"),
        help="noise of the flange poses per axis; default: the motion file's, else 0.1 0.02, checked against the views",
    )
    p.add_argument("--refine-camera", action="store_true", help="estimate the camera's intrinsics too")
    p.add_argument("--no-projector-distortion", action="store_true", help="do not look for distortion of the projector")
    p.add_argument("--no-centroids", action="store_true", help="take dots for points, not for centroids of discs")
    p.add_argument("--no-left-out", action="store_true", help="skip the errors of views left out")
    return p


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    return run_command(_parser(), _run, arguments)


def _run(args: argparse.Namespace) -> None:
    motion = load_motion(args.motion)
    pattern = Pattern.load(args.pattern)
    views, notes = load_views(motion, args.correspondences, min_confidence=args.min_confidence)
    for note in notes:
        print(f"left out: {note}", file=sys.stderr)
    options = SelfCalibrationOptions(
        robot=_robot_noise(args, motion),
        refine_camera=args.refine_camera,
        projector_distortion=not args.no_projector_distortion,
        left_out=not args.no_left_out,
        spot_diameter=None if args.no_centroids else pattern.spot_diameter,
    )
    with tqdm(total=_STAGES, desc="self-calibration", delay=2.0, disable=None) as bar:

        def progress(stage: str) -> None:
            bar.set_postfix_str(stage)
            bar.update()

        size = (pattern.projector_width, pattern.projector_height)
        result = self_calibrate(views, motion.camera, pattern.centers, size, options, progress)
    print(summary(result))
    for path in save(result, args.output, pattern_id=pattern.pattern_id):
        print(f"wrote {path}")


def _robot_noise(args: argparse.Namespace, motion: Motion) -> RobotNoise:
    default = RobotNoise()
    if args.robot_noise:
        return RobotNoise(args.robot_noise[0] * 1e-3, math.radians(args.robot_noise[1]), belief=20.0)
    position, rotation = motion.position_sigma, motion.rotation_sigma
    if not position or not rotation:
        return default
    return RobotNoise(position, rotation, belief=10.0)


def summary(result: SelfCalibration) -> str:
    """Return the result in lines for people: values with 95 % limits, training and left-out errors, warnings."""

    def pose(name: str, transform: np.ndarray, covariance: np.ndarray) -> list[str]:
        limit = 1.96 * np.sqrt(np.diag(covariance))
        position = ", ".join(
            f"{1e3 * x:.2f} +- {1e3 * s:.2f}" for x, s in zip(transform[:3, 3], limit[:3], strict=True)
        )
        rotation = ", ".join(f"{np.degrees(s):.4f}" for s in limit[3:])
        return [f"{name}: position {position} mm; rotation +- {rotation} deg"]

    k, sigma = result.projector.matrix, result.projector_sigma
    values = {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
    if "k1" in sigma:
        values["k1"] = result.projector.coefficients[0]
    intrinsics = ", ".join(f"{name} {value:.5g} +- {1.96 * sigma[name]:.2g}" for name, value in values.items())
    left = result.left_out
    worst = result.worst_view
    lines = [
        f"{len(result.names)} views, {result.observations} observations of {len(result.points)} dots, {result.rejected}"
        " rejected (limits are 95 %)",
        *pose("flange_from_camera", result.flange_from_camera, result.hand_eye_covariance),
        *pose("base_from_projector", result.base_from_projector, result.projector_pose_covariance),
        f"projector [px]: {intrinsics}",
        f"training error: {result.rms:.3f} px in the camera, {result.projector_rms:.3f} px in the projector,"
        f" {1e3 * result.position_rms:.3f} mm and {np.degrees(result.rotation_rms):.4f} deg per axis of the flange"
        f" poses; worst view {result.names[worst]} with {result.view_rms[worst]:.3f} px",
        f"left-out error: {left.pixels:.3f} px, {1e3 * left.points:.3f} mm of the dots, {1e3 * left.position:.3f} mm"
        f" and {np.degrees(left.rotation):.4f} deg of the camera",
    ]
    return "\n".join(lines + [f"warning: {text}" for text in result.warnings])


if __name__ == "__main__":
    sys.exit(main())
