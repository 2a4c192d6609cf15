"""Procedure ``hand_eye``: the camera's mount on the flange from views of a chessboard that stands still."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pattern_gen.projection import FrameRequest
from sl_calibration.camera_calibration import view_pose
from sl_calibration.chessboard import Board, detect_corners
from sl_calibration.grid_files import save_hand_eye_calibration
from sl_calibration.hand_eye import HandEye, HandEyeOptions, calibrate_hand_eye
from sl_calibration.motion_plan import Coverage, Estimate
from sl_calibration.pose_stream import PoseStream
from sl_calibration.procedures.board_views import board_coverage
from sl_calibration.procedures.camera import common_size
from sl_calibration.procedures.procedure import Outcome, Setup, Shot, Source, flange_poses, the_pose
from sl_calibration.self_calibration.consistency import motion_spread
from sl_calibration.sessions import Sample
from sl_common import transforms
from sl_common.calibration_files import HAND_EYE_FILE
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError, StructuredLightError

Array = NDArray[np.float64]

POSES_ADVISED = 15


@dataclass(frozen=True, kw_only=True)
class HandEyeProcedure:
    """Hand-eye calibration; the board stands still, the arm takes the camera around it."""

    board: Board
    options: HandEyeOptions = field(default_factory=lambda: HandEyeOptions(max_offset=0.0, reject_outliers=True))

    name = "hand_eye"
    source = Source.IMAGES
    robot = True
    uses_camera = True
    uses_pattern = False
    writes = (HAND_EYE_FILE,)

    @property
    def samples_needed(self) -> int:
        """Fewest poses accepted."""
        return self.options.min_poses

    def frames(self, setup: Setup) -> list[FrameRequest]:
        """Whatever light there is."""
        return []

    def measure(self, shot: Shot, setup: Setup) -> Sample:
        """Detect the board; its pose follows from the camera model at the time of the computation."""
        image = shot.images[-1]
        setup.known_camera()
        corners = detect_corners(image, self.board)
        size = np.array([image.shape[1], image.shape[0]])
        arrays = {"corners": corners, "size": size, **the_pose(shot)}
        return Sample(f"image_{shot.stamp}", shot.stamp, arrays)

    def points(self, sample: Sample) -> int:
        """Number of corners."""
        return int(np.isfinite(sample.arrays["corners"]).all(-1).sum())

    def estimate(self, samples: Sequence[Sample], setup: Setup) -> Estimate | None:
        """The calibration of the samples so far."""
        if setup.camera is None or len(samples) < self.samples_needed:
            return None
        try:
            result, eye = self._calibrate(samples, setup.camera)
        except StructuredLightError:
            return None
        middle = transforms.apply(result.base_from_target, self.board.points.mean(0)[None])[0]
        distance = np.linalg.norm(eye[:, :3, 3], axis=-1)
        return Estimate(result.flange_from_camera, middle, float(np.ptp(distance) / distance.mean()))

    def coverage(self, samples: Sequence[Sample], setup: Setup, estimate: Estimate | None) -> Coverage:
        """Share of the image, axes of rotation of the flange, spread of distances."""
        corners = [sample.arrays["corners"] for sample in samples]
        seen = board_coverage(
            corners, self.board, common_size(samples), needed=self.samples_needed, advised=POSES_ADVISED
        )
        if not samples:
            return seen
        spread = motion_spread(np.stack(flange_poses(samples)))
        parts = [f"{len(samples)} samples"]
        if len(samples) < self.samples_needed:
            parts.append(f"at least {self.samples_needed} are needed, {POSES_ADVISED} advised")
        if len(samples) > 1 and spread.second < self.options.least_angle:
            parts.append(
                f"turned by {np.degrees(spread.first):.0f} deg about an axis, {np.degrees(spread.second):.1f} deg"
                " across: turn about other axes too, by 30 deg and more"
            )
        elif len(samples) >= POSES_ADVISED:
            parts.append("enough: call ~/compute")
        return Coverage(seen.image, spread.axes, seen.depth, "; ".join(parts))

    def compute(self, samples: Sequence[Sample], setup: Setup) -> Outcome:
        """Calibrate the mount."""
        result, _ = self._calibrate(samples, setup.known_camera())
        sigma = np.sqrt(np.diag(result.covariance))
        used = [samples[row - 1] for row in result.rows]
        rejected = [samples[row - 1].name for row in result.rejected_rows]
        errors = self._pixel_errors(used, result, setup.known_camera())
        message = (
            f"{len(used)} poses, target off its one pose by {1e3 * result.position_error.mean():.2f} mm and"
            f" {np.degrees(result.rotation_error.mean()):.3f} deg in training,"
            f" {1e3 * result.left_out_position.mean():.2f} mm and {np.degrees(result.left_out_rotation.mean()):.3f} deg"
            f" left out; hand-eye to {1e3 * np.linalg.norm(sigma[:3]):.2f} mm and"
            f" {np.degrees(np.linalg.norm(sigma[3:])):.3f} deg (one sigma)"
        )
        message += f"; left out as outliers: {', '.join(rejected)}" if rejected else ""
        residuals = {s.name: e for s, e in zip(used, errors, strict=True)}
        training = float(np.sqrt(np.mean(np.square(errors))))
        return Outcome(result, message, residuals, training, hand_eye_sigma=sigma)

    def save(self, outcome: Outcome, folder: Path, setup: Setup) -> list[Path]:
        """Write hand_eye.yaml."""
        return [save_hand_eye_calibration(folder / HAND_EYE_FILE, outcome.result)]

    def _calibrate(self, samples: Sequence[Sample], camera: CameraModel) -> tuple[HandEye, Array]:
        """Return the calibration and the board's poses (N, 4, 4) in the camera."""
        if len(samples) < self.samples_needed:
            raise InvalidInputError(
                f"too few poses: {len(samples)}, at least {self.samples_needed} are needed, better {POSES_ADVISED}"
            )
        eye = np.array([view_pose(s.arrays["corners"], self.board.points, camera) for s in samples]).reshape(-1, 4, 4)
        times, rows = np.arange(float(len(samples))), np.arange(1, len(samples) + 1)
        hand = np.array(flange_poses(samples)).reshape(-1, 4, 4)
        result = calibrate_hand_eye(
            PoseStream(times, hand, rows), PoseStream(times, eye, rows), self.options, eye_inverted=False
        )
        return result, eye

    def _pixel_errors(self, samples: Sequence[Sample], result: HandEye, camera: CameraModel) -> list[float]:
        """Return the RMS reprojection error [px] of each sample, the board at its one pose."""
        out = []
        for sample in samples:
            base_from_camera = sample.arrays["base_from_flange"] @ result.flange_from_camera
            seen = transforms.apply(transforms.inverse(base_from_camera) @ result.base_from_target, self.board.points)
            error = np.linalg.norm(camera.project(seen) - sample.arrays["corners"], axis=-1)
            out.append(float(np.sqrt(np.nanmean(error**2))))
        return out
