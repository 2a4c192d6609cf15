"""What can go wrong in a self-calibration, one class per condition."""

from sl_common.errors import StructuredLightError


class SelfCalibrationError(StructuredLightError):
    """The views do not give a calibration."""


class TooFewViewsError(SelfCalibrationError):
    """Not enough views, or views that share too few dots."""


class DegenerateMotionError(SelfCalibrationError):
    """The flange's motion leaves the hand-eye transform undetermined; the message says which motion to add."""


class DegenerateSceneError(SelfCalibrationError):
    """The scene leaves the projector undetermined: the dots lie on one plane."""


class InconsistentPosesError(SelfCalibrationError):
    """Flange poses and images do not belong together; the message names the views."""
