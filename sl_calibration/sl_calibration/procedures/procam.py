"""Procedure ``procam``: camera and projector from a Gray code sequence on a chessboard (section III.B)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pattern_gen.gray_code import Arrangement, Axis, bit_count
from pattern_gen.projection import FrameRequest, Mode
from sl_calibration.camera_calibration import name_odd_view, rms
from sl_calibration.chessboard import Board
from sl_calibration.gray_code import make_capture
from sl_calibration.grid_files import PAIR_FILE, save_procam_calibration
from sl_calibration.motion_plan import Coverage, Estimate
from sl_calibration.procedures.board_views import board_coverage
from sl_calibration.procedures.camera import common_size, stacked
from sl_calibration.procedures.procedure import Outcome, Setup, Shot, Source
from sl_calibration.projector_calibration import MIN_VIEWS, ProcamOptions, calibrate_procam
from sl_calibration.projector_corners import board_in_capture
from sl_calibration.sessions import Sample
from sl_common.calibration_files import CAMERA_FILE, PROJECTOR_FILE, PROJECTOR_POSE_FILE, load_hand_eye

Array = NDArray[np.float64]

VIEWS_ADVISED = 5


@dataclass(frozen=True, kw_only=True)
class ProcamProcedure:
    """Camera and projector on a board: camera and projector stand still, the board is held differently for each sample.

    Attributes:
        board: The chessboard.
        arrangement: Order of the code words, the pattern publisher's.
        options: How to calibrate.
        base_from_flange: (4, 4) pose of the flange that holds the camera during all captures [m]; with it the
            projector's pose in the base is written too, by the calibration folder's hand-eye transform. None: unknown.
    """

    board: Board
    arrangement: Arrangement = Arrangement.REFLECTED
    options: ProcamOptions = field(default_factory=ProcamOptions)
    base_from_flange: Array | None = None

    name = "procam"
    source = Source.IMAGES
    robot = False
    uses_camera = False
    uses_pattern = True
    samples_needed = MIN_VIEWS

    @property
    def writes(self) -> tuple[str, ...]:
        """Files of the pair, and of the projector's pose where it can be told."""
        pair = (CAMERA_FILE, PROJECTOR_FILE, PAIR_FILE)
        return pair if self.base_from_flange is None else (*pair, PROJECTOR_POSE_FILE)

    def frames(self, setup: Setup) -> list[FrameRequest]:
        """Column bits, most significant first, each followed by its inverse, row bits likewise, white, black."""
        size = setup.known_pattern().size
        code = [
            FrameRequest(mode=Mode.GRAY_CODE, axis=axis, bit=bit, inverse=inverse)
            for axis, length in ((Axis.COLUMNS, size[0]), (Axis.ROWS, size[1]))
            for bit in range(bit_count(length))
            for inverse in (False, True)
        ]
        return [*code, FrameRequest(mode=Mode.WHITE), FrameRequest(mode=Mode.BLACK)]

    def measure(self, shot: Shot, setup: Setup) -> Sample:
        """Decode the sequence and carry the board's corners over to the projector."""
        names = [f"image {k}" for k in range(len(shot.images))]
        capture = make_capture(list(shot.images), names, setup.known_pattern().size, self.arrangement)
        corners, mapped = board_in_capture(capture, self.board)
        size = np.array(shot.images[0].shape[1::-1])
        arrays = {"corners": corners, "projector_corners": mapped, "size": size}
        return Sample(f"capture_{shot.stamp}", shot.stamp, arrays)

    def points(self, sample: Sample) -> int:
        """Number of corners known in both."""
        return int(np.isfinite(sample.arrays["projector_corners"]).all(-1).sum())

    def estimate(self, samples: Sequence[Sample], setup: Setup) -> Estimate | None:
        """No robot takes part."""
        return None

    def coverage(self, samples: Sequence[Sample], setup: Setup, estimate: Estimate | None) -> Coverage:
        """Share of the camera's image, tilts and distances of the board."""
        corners = [sample.arrays["corners"] for sample in samples]
        return board_coverage(corners, self.board, common_size(samples), needed=MIN_VIEWS, advised=VIEWS_ADVISED)

    def compute(self, samples: Sequence[Sample], setup: Setup) -> Outcome:
        """Calibrate camera and projector."""
        names = [s.name for s in samples]
        in_camera, in_projector = (stacked(samples, key) for key in ("corners", "projector_corners"))
        size, projector = common_size(samples), setup.known_pattern().size
        with name_odd_view(names):
            result = calibrate_procam(in_camera, in_projector, self.board, size, projector, self.options)
        left_out = float(np.nanmean(result.left_out_projector)) if len(names) > MIN_VIEWS else float("nan")
        matrix, sigma = result.projector.matrix, result.projector_parameters
        message = (
            f"{len(names)} captures, training camera {rms(result.camera_residuals):.3f} px, projector"
            f" {rms(result.projector_residuals):.3f} px, left out {left_out:.3f} px, rigid fit"
            f" {np.nanmean(result.rigid_fit):.3f} mm; projector fx {matrix[0, 0]:.1f} +-"
            f" {1.96 * sigma['fx']['sigma']:.1f}, cx {matrix[0, 2]:.1f} +- {1.96 * sigma['cx']['sigma']:.1f},"
            f" cy {matrix[1, 2]:.1f} +- {1.96 * sigma['cy']['sigma']:.1f} px (95 %)"
        )
        per_view = {name: rms(view) for name, view in zip(names, result.projector_residuals, strict=True)}
        pose_sigma = np.sqrt(np.diag(result.pose_covariance))
        return Outcome(result, message, per_view, rms(result.projector_residuals), left_out, projector_sigma=pose_sigma)

    def save(self, outcome: Outcome, folder: Path, setup: Setup) -> list[Path]:
        """Write camera.yaml, projector.yaml and camera_from_projector.yaml, and projector_pose.yaml."""
        flange = self.base_from_flange
        hand_eye = None if flange is None else load_hand_eye(setup.folder)
        return save_procam_calibration(folder, outcome.result, base_from_flange=flange, hand_eye=hand_eye)
