"""From the record of a run to the rows of its report."""

from collections.abc import Sequence

import numpy as np

from sl_bringup.demo.acts import Motion
from sl_bringup.demo.evaluation import dot_errors, point_errors, pose_errors
from sl_bringup.demo.record import Record, pose_from_message
from sl_bringup.demo.report import MAX_ORIENTATION_ERROR, MAX_POSITION_ERROR, Row
from sl_bringup.demo.truth import Truth
from sl_msgs.msg import Pattern
from sl_sim.cell import Cell, CellSettings


def pattern_centers(message: Pattern) -> np.ndarray:
    """Return the spot centres (rows, cols, 2) [projector px] of a pattern."""
    centers = np.stack([message.center_u, message.center_v], axis=-1).astype(np.float64)
    return centers.reshape(message.rows, message.cols, 2)


def true_cell(truth: Truth) -> Cell:
    """Rebuild the cell that the node has simulated."""
    return Cell(CellSettings(**truth.data["cell"]))


def rows(
    record: Record, truth: Truth, cell: Cell, pattern: Pattern, motion: Motion | None, standoff: float
) -> list[Row]:
    """Return all rows of the report."""
    centers = pattern_centers(pattern)
    dots = dot_errors(cell, centers, record.correspondences, record)
    points = point_errors(cell, centers, record.clouds, record)
    out = [
        Row("dots decoded per image, median", _median([n for _, n in record.dots]), "", digits=0),
        Row("decoded dots compared with the truth", dots.count, "", digits=0),
        Row("of these with a wrong row or column", 100 * dots.wrong, "%", digits=3),
        Row("dot centre error, median", dots.median_px, "px", digits=3),
        Row("points compared with the truth", points.count, "", digits=0),
        Row("point error, median", 1e3 * points.median, "mm"),
        Row("point error, 95th percentile", 1e3 * points.p95, "mm"),
        Row("distance of points from the surface, median", 1e3 * points.median_normal, "mm"),
    ]
    out += _arm_rows(record, truth, cell, motion, standoff)
    out += _timing_rows(record)
    return out


def _arm_rows(record: Record, truth: Truth, cell: Cell, motion: Motion | None, standoff: float) -> list[Row]:
    limit_mm, limit_deg = 1e3 * MAX_POSITION_ERROR, float(np.degrees(MAX_ORIENTATION_ERROR))
    values = [np.nan] * 4
    if motion is not None:
        stamp = max(record.camera_poses)
        errors = pose_errors(
            cell,
            pose_from_message(motion.result.target),
            record.camera_poses[stamp],
            standoff,
            record.object_poses.get(stamp),
        )
        values = [errors.position, errors.orientation, abs(errors.standoff), errors.tilt]
    report = truth.report
    rows = [
        Row("camera position against the commanded pose", 1e3 * values[0], "mm", limit_mm),
        Row("camera orientation against the commanded pose", np.degrees(values[1]), "deg", limit_deg),
        Row("stand-off from the true surface, error", 1e3 * values[2], "mm", limit_mm),
        Row("optical axis against the true surface normal", np.degrees(values[3]), "deg", limit_deg),
        Row("orders until the arm arrived", motion.orders if motion else np.nan, "", digits=0),
        Row("setpoints received by the driver", report["setpoints"], "", digits=0),
        Row("limit violations counted by the driver", truth.violations, "", 0.0, digits=0),
    ]
    for kind, value in report.get("worst", {}).items():
        rows.append(Row(f"  largest {kind}, share of its limit", 100 * value, "%", digits=1))
    rows.append(Row("jumps at the beginning of a stream", report.get("first_setpoint_jumps", 0), "", 0.0, digits=0))
    rows.append(Row("interruptions of the stream while moving", report.get("gaps", 0), "", digits=0))
    return rows


def _timing_rows(record: Record) -> list[Row]:
    rate = record.rate
    return [
        Row("camera images", rate("camera/image_raw"), "1/s", digits=1),
        Row("correspondences", rate("correspondences"), "1/s", digits=1),
        Row("point clouds", rate("points"), "1/s", digits=1),
        Row("joint states", rate("joint_states"), "1/s", digits=1),
        Row("time to decode an image, median", 1e3 * _median(record.decode_times), "ms", digits=1),
        Row("latency exposure to image, median", 1e3 * _median(record.latencies["camera/image_raw"]), "ms", digits=1),
        Row("latency exposure to dots, median", 1e3 * _median(record.latencies["correspondences"]), "ms", digits=1),
        Row("latency exposure to points, median", 1e3 * _median(record.latencies["points"]), "ms", digits=1),
    ]


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if len(values) else np.nan
