"""Procedure ``camera``: the camera's intrinsics from images of a chessboard."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pattern_gen.projection import FrameRequest
from sl_calibration.camera_calibration import (
    MIN_VIEWS,
    CameraOptions,
    calibrate_camera,
    name_odd_view,
    rms,
    root_mean_square,
    same_views,
)
from sl_calibration.chessboard import Board, detect_corners
from sl_calibration.grid_files import save_camera_calibration
from sl_calibration.motion_plan import Coverage, Estimate
from sl_calibration.procedures.board_views import board_coverage
from sl_calibration.procedures.procedure import Outcome, Setup, Shot, Source
from sl_calibration.sessions import Sample
from sl_common.calibration_files import CAMERA_FILE
from sl_common.errors import InvalidInputError

VIEWS_ADVISED = 10


@dataclass(frozen=True, kw_only=True)
class CameraProcedure:
    """Camera calibration; the board is given by its inner corners and the side of a square."""

    board: Board
    options: CameraOptions = field(default_factory=CameraOptions)

    name = "camera"
    source = Source.IMAGES
    robot = False
    uses_camera = False
    uses_pattern = False
    samples_needed = MIN_VIEWS
    writes = (CAMERA_FILE,)

    def frames(self, setup: Setup) -> list[FrameRequest]:
        """Whatever light there is."""
        return []

    def measure(self, shot: Shot, setup: Setup) -> Sample:
        """Detect the board's corners."""
        image = shot.images[-1]
        corners = detect_corners(image, self.board)
        size = np.array([image.shape[1], image.shape[0]])
        return Sample(f"image_{shot.stamp}", shot.stamp, {"corners": corners, "size": size})

    def points(self, sample: Sample) -> int:
        """Number of corners."""
        return int(np.isfinite(sample.arrays["corners"]).all(-1).sum())

    def estimate(self, samples: Sequence[Sample], setup: Setup) -> Estimate | None:
        """No robot takes part."""
        return None

    def coverage(self, samples: Sequence[Sample], setup: Setup, estimate: Estimate | None) -> Coverage:
        """Share of the image, tilts and distances of the board."""
        corners = [sample.arrays["corners"] for sample in samples]
        return board_coverage(corners, self.board, common_size(samples), needed=MIN_VIEWS, advised=VIEWS_ADVISED)

    def compute(self, samples: Sequence[Sample], setup: Setup) -> Outcome:
        """Calibrate the camera."""
        corners = stacked(samples, "corners")
        twins = same_views(corners)
        different = [k for k in range(len(samples)) if k not in twins]
        names, corners = [samples[k].name for k in different], corners[different]
        with name_odd_view(names):
            size = common_size(samples)
            result = calibrate_camera(corners, self.board, *size, self.options)
        training, left_out = rms(result.residuals), root_mean_square(result.left_out)
        matrix, sigma = result.camera.matrix, result.parameters
        message = (
            f"{len(names)} views, model {result.parametrisation.model}, {training:.3f} px training and"
            f" {left_out:.3f} px left-out error; fx {matrix[0, 0]:.2f} +- {1.96 * sigma['fx']['sigma']:.2f},"
            f" cx {matrix[0, 2]:.2f} +- {1.96 * sigma['cx']['sigma']:.2f},"
            f" cy {matrix[1, 2]:.2f} +- {1.96 * sigma['cy']['sigma']:.2f} px (95 %)"
        )
        if twins:
            message += f"; {len(twins)} samples show the board where an earlier one does and are left out"
        per_view = dict(zip(names, result.per_view.tolist(), strict=True))
        return Outcome(result, message, per_view, training, left_out)

    def save(self, outcome: Outcome, folder: Path, setup: Setup) -> list[Path]:
        """Write camera.yaml."""
        return [save_camera_calibration(folder / CAMERA_FILE, outcome.result)]


def common_size(samples: Sequence[Sample]) -> tuple[int, int]:
    """Return the images' (width, height) [px]; raises InvalidInputError where they differ. (1, 1) for none."""
    sizes = {(int(s.arrays["size"][0]), int(s.arrays["size"][1])) for s in samples}
    if len(sizes) > 1:
        listed = " and ".join(f"{w}x{h}" for w, h in sorted(sizes))
        raise InvalidInputError(f"images of {listed}: all must come from one camera at one resolution")
    return sizes.pop() if sizes else (1, 1)


def stacked(samples: Sequence[Sample], name: str) -> NDArray[np.float64]:
    """Return an array (N, 2) that all samples have, such as the board's corners, as (V, N, 2)."""
    return np.array([s.arrays[name] for s in samples], dtype=np.float64) if samples else np.zeros((0, 0, 2))
