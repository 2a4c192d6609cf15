"""Procedure ``self``: projector, hand-eye transform and dots from known robot motion, without a grid."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pattern_gen.projection import FrameRequest
from sl_calibration.motion_plan import SAMPLES_NEEDED, Coverage, Estimate, coverage, first_estimate
from sl_calibration.procedures.procedure import Outcome, Setup, Shot, Source, the_pose
from sl_calibration.self_calibration.calibrate import SelfCalibrationOptions, self_calibrate
from sl_calibration.self_calibration.files import describe, save
from sl_calibration.self_calibration.views import LEAST_DOTS, View
from sl_calibration.sessions import Sample
from sl_common.calibration_files import CAMERA_FILE, HAND_EYE_FILE, PROJECTOR_FILE, PROJECTOR_POSE_FILE
from sl_common.errors import InvalidInputError


@dataclass(frozen=True, kw_only=True)
class SelfMotion:
    """Self-calibration.

    Attributes:
        options: How to calibrate; the spots' diameter is the pattern's.
        min_confidence: Dots of lower confidence are left out.
        least_dots: Fewest dots of a usable view.
    """

    options: SelfCalibrationOptions = field(default_factory=SelfCalibrationOptions)
    min_confidence: float = 0.9
    least_dots: int = 60

    name = "self"
    source = Source.DOTS
    robot = True
    uses_camera = True
    uses_pattern = True
    samples_needed = SAMPLES_NEEDED
    writes = (CAMERA_FILE, PROJECTOR_FILE, HAND_EYE_FILE, PROJECTOR_POSE_FILE)

    def frames(self, setup: Setup) -> list[FrameRequest]:
        """The pattern itself."""
        return []

    def measure(self, shot: Shot, setup: Setup) -> Sample:
        """Keep the dots that are sure enough; refuses another pattern's, and too few."""
        assert shot.dots is not None
        dots, pattern = shot.dots, setup.known_pattern()
        if dots.pattern_id != pattern.pattern_id:
            raise InvalidInputError(f"correspondences of pattern '{dots.pattern_id}', expected '{pattern.pattern_id}'")
        keep = (dots.confidence >= self.min_confidence) & np.isfinite(dots.pixels).all(-1)
        least = max(self.least_dots, LEAST_DOTS)
        if keep.sum() < least:
            raise InvalidInputError(f"{int(keep.sum())} dots of {len(keep)} are sure enough, {least} are needed")
        arrays = {"row": dots.row[keep], "col": dots.col[keep], "pixels": dots.pixels[keep], **the_pose(shot)}
        return Sample(f"view_{shot.stamp}", shot.stamp, arrays)

    def points(self, sample: Sample) -> int:
        """Number of dots."""
        return len(sample.arrays["row"])

    def estimate(self, samples: Sequence[Sample], setup: Setup) -> Estimate | None:
        """The linear solution of the last views."""
        if setup.camera is None or setup.pattern is None:
            return None
        return first_estimate(views(samples)[-8:], setup.camera, setup.pattern.centers)

    def coverage(self, samples: Sequence[Sample], setup: Setup, estimate: Estimate | None) -> Coverage:
        """Share of the image, axes of rotation, spread of depth."""
        return coverage(views(samples), setup.camera, estimate)

    def compute(self, samples: Sequence[Sample], setup: Setup) -> Outcome:
        """Self-calibrate."""
        camera, pattern = setup.known_camera(), setup.known_pattern()
        options = SelfCalibrationOptions(
            robot=self.options.robot,
            refine_camera=self.options.refine_camera,
            projector_distortion=self.options.projector_distortion,
            left_out=self.options.left_out,
            spot_diameter=pattern.spot_diameter,
        )
        result = self_calibrate(views(samples), camera, pattern.centers, pattern.size, options)
        return Outcome(
            result,
            describe(result),
            dict(zip(result.names, result.view_rms.tolist(), strict=True)),
            result.rms,
            result.left_out.pixels,
            np.sqrt(np.diag(result.hand_eye_covariance)),
            np.sqrt(np.diag(result.projector_pose_covariance)),
        )

    def save(self, outcome: Outcome, folder: Path, setup: Setup) -> list[Path]:
        """Write the calibration folder."""
        return save(outcome.result, folder, pattern_id=setup.known_pattern().pattern_id)


def views(samples: Sequence[Sample]) -> list[View]:
    """Return samples as views."""
    return [
        View(s.name, s.arrays["row"], s.arrays["col"], s.arrays["pixels"], s.arrays["base_from_flange"], s.stamp)
        for s in samples
    ]
