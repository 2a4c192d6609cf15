"""What a self-calibration gives, and how it is written."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration.bundle_problem import Noise
from sl_common.cameras import CameraModel

Array = NDArray[np.float64]

CHI2_95_6 = 12.592
"""95 % quantile of chi-square with six degrees of freedom: a pose's region is delta^T C^-1 delta below it."""


@dataclass(frozen=True)
class LeftOut:
    """Errors of views that took no part in the fit, RMS over the folds; NaN: too few views.

    Attributes:
        pixels: Reprojection of the dots with the flange pose as reported [px].
        points: Dots triangulated from the view alone against those of the other views [m].
        position: Camera position from the image against the one from the robot [m].
        rotation: Camera orientation likewise [rad].
    """

    pixels: float = float("nan")
    points: float = float("nan")
    position: float = float("nan")
    rotation: float = float("nan")


@dataclass(frozen=True, eq=False)
class SelfCalibration:
    """Result of :func:`self_calibrate`.

    Attributes:
        camera: Camera model (as given, or refined).
        projector: Projector model.
        flange_from_camera: (4, 4) hand-eye transform [m].
        base_from_projector: (4, 4) projector pose [m].
        hand_eye_covariance: (6, 6) of x y z rx ry rz [m, rad], all else marginalised out.
        projector_pose_covariance: (6, 6) likewise.
        projector_sigma: Standard deviation of each projector parameter, by name [px, 1].
        camera_sigma: Likewise of the camera parameters that were refined.
        covariance: (P, P) joint covariance of hand-eye, projector pose, projector and camera parameters, in that order.
        dots: (K, 2) row and column of each dot.
        points: (K, 3) in the base frame [m].
        point_covariance: (K, 3, 3) [m^2].
        point_views: (K,) number of views that each was seen in.
        names: Names of the views used.
        view_rms: (V,) RMS reprojection error of each [px].
        rms: Training error over all views [px].
        projector_rms: RMS of the projector residuals [px].
        position_rms: RMS correction of the reported flange positions, per axis [m].
        rotation_rms: Of their rotations, per axis [rad].
        left_out: Errors of views left out.
        noise: Standard deviations estimated from the residuals.
        inflation: Variance factors for correlated errors, of camera and projector.
        dot_variance: Variance of the dots that shifts their centroids, and its standard deviation [projector px^2];
            0, 0: not modelled.
        observations: Number of observations used.
        rejected: Number of observations rejected as outliers.
        warnings: Sentences: views left out and why, weak spots and what to add.
        scene_depth: RMS distance of the dots from their best plane [m].
    """

    camera: CameraModel
    projector: CameraModel
    flange_from_camera: Array
    base_from_projector: Array
    hand_eye_covariance: Array
    projector_pose_covariance: Array
    projector_sigma: dict[str, float]
    camera_sigma: dict[str, float]
    covariance: Array
    dots: NDArray[np.int64]
    points: Array
    point_covariance: Array
    point_views: NDArray[np.int64]
    names: tuple[str, ...]
    view_rms: Array
    rms: float
    projector_rms: float
    position_rms: float
    rotation_rms: float
    left_out: LeftOut
    noise: Noise
    inflation: tuple[float, float]
    dot_variance: tuple[float, float]
    observations: int
    rejected: int
    scene_depth: float
    warnings: list[str] = field(default_factory=list)

    @property
    def worst_view(self) -> int:
        """Index of the view with the largest RMS."""
        return int(np.argmax(self.view_rms))
