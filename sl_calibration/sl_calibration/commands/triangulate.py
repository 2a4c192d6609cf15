"""Command triangulate: metric points from correspondences and flange poses, as the node triangulator does."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pattern_gen import Pattern
from sl_calibration.self_calibration.inputs import load_motion, load_views
from sl_calibration.self_calibration.views import View
from sl_calibration.triangulation import Triangulation, TriangulationOptions, camera_from_projector, triangulate
from sl_common import transforms
from sl_common.calibration_files import CAMERA_FILE, PROJECTOR_FILE, load_camera, load_hand_eye, load_projector_pose
from sl_common.commands import make_parser, progress, run_command
from sl_common.errors import InvalidInputError
from sl_common.files import write_text

EXAMPLE = """\
  ros2 run sl_calibration triangulate --calibration calibration --motion motion.json --correspondences decoded \\
      --pattern pattern.yaml --output points
writes points/NAME.csv with row,col,x,y,z [m] for every image of the motion and prints how well the views agree."""


def _parser() -> argparse.ArgumentParser:
    """Return the command's argument parser."""
    p = make_parser("sl_calibration triangulate", __doc__ or "", EXAMPLE)
    p.add_argument(
        "--calibration", required=True, help="folder with projector.yaml, hand_eye.yaml, projector_pose.yaml"
    )
    p.add_argument("--motion", required=True, help="JSON with the camera and each image's flange pose")
    p.add_argument("--correspondences", required=True, help="folder with NAME.csv as decode_images writes it")
    p.add_argument("--pattern", required=True, help="pattern file (YAML) that was projected")
    p.add_argument("--output", required=True, help="folder for NAME.csv")
    p.add_argument("--frame", choices=("base", "camera"), default="base", help="frame of the points (default: base)")
    p.add_argument(
        "--max-epipolar-distance", type=float, default=2.0, metavar="PX", help="refuse dots farther off (default: 2 px)"
    )
    return p


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    return run_command(_parser(), _run, arguments)


def _run(args: argparse.Namespace) -> None:
    folder = Path(args.calibration)
    motion = load_motion(args.motion)
    camera = load_camera(folder / CAMERA_FILE) if (folder / CAMERA_FILE).exists() else motion.camera
    projector = load_camera(folder / PROJECTOR_FILE)
    hand_eye, pose = load_hand_eye(folder).transform, load_projector_pose(folder).transform
    pattern = Pattern.load(args.pattern)
    options = TriangulationOptions(max_epipolar_distance=args.max_epipolar_distance)
    views, notes = load_views(motion, args.correspondences, least_dots=1)
    for note in notes:
        print(f"left out: {note}", file=sys.stderr)

    results = []
    for view in progress(views, "triangulating"):
        _check_dots(view, pattern)
        extrinsics = camera_from_projector(view.base_from_flange, hand_eye, pose)
        projected = pattern.centers[view.row, view.col]
        results.append(triangulate(camera, projector, extrinsics, view.pixels, projected, options))
    in_base = [
        transforms.apply(view.base_from_flange @ hand_eye, result.points)
        for view, result in zip(views, results, strict=True)
    ]
    for view, result, points in zip(views, results, in_base, strict=True):
        chosen = points if args.frame == "base" else result.points
        _write(Path(args.output) / f"{view.name}.csv", view, result, chosen)
    _print_summary(views, results, in_base, pattern.cols)
    print(f"wrote {len(views)} files to {Path(args.output).resolve()}")


def _check_dots(view: View, pattern: Pattern) -> None:
    rows, cols = pattern.rows, pattern.cols
    if len(view.row) and (min(view.row.min(), view.col.min()) < 0 or view.row.max() >= rows or view.col.max() >= cols):
        raise InvalidInputError(
            f"{view.name}: dots up to row {view.row.max()}, column {view.col.max()}, but the pattern has {rows}x{cols}:"
            " give the pattern file that was projected"
        )


def _write(path: Path, view: View, result: Triangulation, points: np.ndarray) -> None:
    lines = ["row,col,x,y,z"]
    for i in np.flatnonzero(result.valid):
        x, y, z = points[i]
        lines.append(f"{view.row[i]},{view.col[i]},{x:.6f},{y:.6f},{z:.6f}")
    write_text(path, "\n".join(lines) + "\n")


def _print_summary(views: list[View], results: list[Triangulation], in_base: list[np.ndarray], cols: int) -> None:
    print(f"{'image':24s} {'dots':>6s} {'points':>6s} {'epipolar':>8s} {'behind':>6s} {'median distance':>15s}")
    for view, result in zip(views, results, strict=True):
        counts = result.counts()
        median = float(np.nanmedian(result.epipolar_distance)) if len(view.row) else np.nan
        print(
            f"{view.name:24s} {len(view.row):6d} {counts['none']:6d} {counts['epipolar']:8d}"
            f" {counts['behind']:6d} {median:12.3f} px"
        )
    dot = np.concatenate([(view.row * cols + view.col)[r.valid] for view, r in zip(views, results, strict=True)])
    points = np.concatenate([p[r.valid] for p, r in zip(in_base, results, strict=True)])
    _, index, count = np.unique(dot, return_inverse=True, return_counts=True)
    mean = np.stack([np.bincount(index.ravel(), points[:, k]) for k in range(3)], axis=-1) / count[:, None]
    several = count[index.ravel()] > 1
    if several.any():
        deviation = np.linalg.norm(points - mean[index.ravel()], axis=-1)[several]
        print(f"dots seen in several images: {1e3 * np.sqrt(np.mean(deviation**2)):.3f} mm RMS from their mean")


if __name__ == "__main__":
    sys.exit(main())
