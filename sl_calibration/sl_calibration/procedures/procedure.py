"""What every calibration procedure offers, and what it is given."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pattern_gen.projection import FrameRequest
from sl_calibration.motion_plan import Coverage, Estimate
from sl_calibration.sessions import Sample, SessionPattern
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]


class Source(Enum):
    """What a sample is made of: the decoder's dots or the camera's images."""

    DOTS = "dots"
    IMAGES = "images"


@dataclass(frozen=True, eq=False)
class ShotDots:
    """Dots of one image: pattern, (N,) rows, columns and confidences, (N, 2) raw camera pixels."""

    pattern_id: str
    row: NDArray[np.int64]
    col: NDArray[np.int64]
    pixels: Array
    confidence: Array


@dataclass(frozen=True, eq=False)
class Shot:
    """What was seen at one moment.

    Attributes:
        stamp: Of the (last) image [ns].
        dots: Of the image, for procedures of Source.DOTS.
        images: (H, W, 3) uint8 BGR, one for each frame of the procedure; one where it projects nothing of its own.
        base_from_flange: (4, 4) at the stamp; None for procedures without a robot.
        joints: (J,) joint positions likewise [rad].
    """

    stamp: int
    dots: ShotDots | None = None
    images: tuple[NDArray[np.uint8], ...] = ()
    base_from_flange: Array | None = None
    joints: Array | None = None


@dataclass(frozen=True, eq=False)
class Setup:
    """What is known while a session goes on: the camera model, the pattern, the folder of calibration files."""

    camera: CameraModel | None
    pattern: SessionPattern | None
    folder: Path

    def known_camera(self) -> CameraModel:
        """Return the camera model; raises InvalidInputError where none is known yet."""
        if self.camera is None:
            raise InvalidInputError(f"no camera model: neither a camera.yaml in {self.folder} nor camera/camera_info")
        return self.camera

    def known_pattern(self) -> SessionPattern:
        """Return the pattern; raises InvalidInputError where none is known yet."""
        if self.pattern is None:
            raise InvalidInputError("no pattern received yet: is pattern_publisher running?")
        return self.pattern


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a computation gave.

    Attributes:
        result: The procedure's own result, for its ``save``.
        message: It in one sentence, with the numbers.
        residuals: RMS residual of each sample used, by name [px].
        rms: Training residual [px].
        rms_left_out: Of samples left out of the fit [px]; NaN: not computed.
        hand_eye_sigma: (6,) one standard deviation of x y z rx ry rz [m, rad]; NaN: not part of it.
        projector_sigma: (6,) likewise of the projector's pose.
    """

    result: Any
    message: str
    residuals: dict[str, float]
    rms: float
    rms_left_out: float = float("nan")
    hand_eye_sigma: Array = field(default_factory=lambda: np.full(6, np.nan))
    projector_sigma: Array = field(default_factory=lambda: np.full(6, np.nan))


class Procedure(Protocol):
    """One way of calibrating. Its methods are pure: samples in, numbers out."""

    @property
    def name(self) -> str:
        """As the node's parameter ``procedure`` gives it."""
        ...

    @property
    def source(self) -> Source:
        """What a sample is made of."""
        ...

    @property
    def robot(self) -> bool:
        """Whether a sample carries the flange pose, so that the robot must rest."""
        ...

    @property
    def uses_camera(self) -> bool:
        """Whether the camera's intrinsics must be known."""
        ...

    @property
    def uses_pattern(self) -> bool:
        """Whether the pattern, or the projector's size, must be known."""
        ...

    @property
    def samples_needed(self) -> int:
        """Fewest samples for a first result."""
        ...

    @property
    def writes(self) -> tuple[str, ...]:
        """Names of the files that ``save`` writes."""
        ...

    def frames(self, setup: Setup) -> list[FrameRequest]:
        """Return the frames that are projected, one image each, for one sample; none: whatever is shown."""
        ...

    def measure(self, shot: Shot, setup: Setup) -> Sample:
        """Make a sample; raises StructuredLightError with the reason where the shot gives none."""
        ...

    def points(self, sample: Sample) -> int:
        """Return the number of points that a sample holds."""
        ...

    def estimate(self, samples: Sequence[Sample], setup: Setup) -> Estimate | None:
        """Return a first estimate of mounting and scene, from which motions are planned; None: none yet."""
        ...

    def coverage(self, samples: Sequence[Sample], setup: Setup, estimate: Estimate | None) -> Coverage:
        """Measure how well the samples cover what the calibration needs, and say what to do next."""
        ...

    def compute(self, samples: Sequence[Sample], setup: Setup) -> Outcome:
        """Calibrate; raises StructuredLightError with what is missing or wrong."""
        ...

    def save(self, outcome: Outcome, folder: Path, setup: Setup) -> list[Path]:
        """Write the files of a result, whole or not at all; returns their absolute paths."""
        ...


def flange_poses(samples: Sequence[Sample]) -> list[Array]:
    """Return base_from_flange (4, 4) of all samples that carry it."""
    return [sample.arrays["base_from_flange"] for sample in samples if "base_from_flange" in sample.arrays]


def the_pose(shot: Shot) -> dict[str, Array]:
    """Return the robot's part of a sample; raises InvalidInputError where the shot has none."""
    if shot.base_from_flange is None or shot.joints is None:
        raise InvalidInputError("no flange pose belongs to the image: are joint_states published?")
    return {"base_from_flange": shot.base_from_flange, "joints": shot.joints}
