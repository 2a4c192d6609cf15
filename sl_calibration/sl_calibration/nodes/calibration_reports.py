"""Results of the calibrator as messages."""

import numpy as np
from geometry_msgs.msg import Pose, Quaternion
from numpy.typing import NDArray
from std_msgs.msg import Header

from sl_calibration.motion_plan import SAMPLES_NEEDED, Coverage
from sl_calibration.nodes.guided_motion import pose_message
from sl_calibration.self_calibration.result import SelfCalibration
from sl_calibration.sessions import Session
from sl_msgs.msg import CalibrationProgress
from sl_msgs.srv import ComputeCalibration


def suggestion(pose: NDArray[np.float64] | None) -> Pose:
    """Return a suggested flange pose as a message; a zero quaternion says that there is none."""
    if pose is None:
        return Pose(orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=0.0))
    return pose_message(pose)


def residuals(result: SelfCalibration | None) -> dict[str, float]:
    """Return the RMS reprojection error [px] of each view used, by name."""
    if result is None:
        return {}
    return dict(zip(result.names, result.view_rms.tolist(), strict=True))


def describe(result: SelfCalibration) -> str:
    """Return a result in one sentence."""
    hand_eye = np.sqrt(np.diag(result.hand_eye_covariance))
    projector = np.sqrt(np.diag(result.projector_pose_covariance))
    text = (
        f"{len(result.names)} views, {result.rms:.3f} px training and {result.left_out.pixels:.3f} px left-out error;"
        f" hand-eye to {1e3 * np.linalg.norm(hand_eye[:3]):.2f} mm and"
        f" {np.degrees(np.linalg.norm(hand_eye[3:])):.3f} deg,"
        f" projector to {1e3 * np.linalg.norm(projector[:3]):.2f} mm and"
        f" {np.degrees(np.linalg.norm(projector[3:])):.3f} deg (one sigma)"
    )
    return "; ".join([text, *result.warnings])


def fill(response: ComputeCalibration.Response, result: SelfCalibration, session: Session) -> None:
    """Fill the answer of ~/compute."""
    names = [view.name for view in session.views]
    response.success, response.message = True, describe(result)
    response.samples = len(result.names)
    response.rms = result.rms
    response.rms_left_out = result.left_out.pixels
    response.worst_sample = names.index(result.names[result.worst_view])
    response.worst_rms = float(result.view_rms[result.worst_view])
    response.hand_eye_sigma = np.sqrt(np.diag(result.hand_eye_covariance)).astype(np.float32)
    response.projector_sigma = np.sqrt(np.diag(result.projector_pose_covariance)).astype(np.float32)


def progress(
    header: Header, session: Session, covered: Coverage, result: SelfCalibration | None, suggested: Pose
) -> CalibrationProgress:
    """Return the message of ~/progress."""
    return CalibrationProgress(
        header=header,
        procedure=session.procedure,
        session=str(session.folder),
        samples=len(session),
        samples_needed=SAMPLES_NEEDED,
        coverage_image=covered.image,
        coverage_rotation=covered.rotation,
        coverage_depth=covered.depth,
        computed=result is not None,
        message=covered.message if result is None else describe(result),
        suggested=suggested,
    )
