"""Results of the calibrator as messages."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from geometry_msgs.msg import Pose, Quaternion
from numpy.typing import NDArray
from std_msgs.msg import Header

from sl_calibration.grid_files import PAIR_FILE, PAIR_KEY
from sl_calibration.motion_plan import Coverage
from sl_calibration.nodes.guided_motion import pose_message
from sl_calibration.procedures.procedure import Outcome, Procedure
from sl_calibration.sessions import Session
from sl_common.calibration_files import (
    CAMERA_FILE,
    HAND_EYE_FILE,
    HAND_EYE_KEY,
    PROJECTOR_FILE,
    PROJECTOR_POSE_FILE,
    PROJECTOR_POSE_KEY,
    load_camera,
    load_pose,
)
from sl_common.files import read_yaml
from sl_common.ros.stamps import from_ns
from sl_msgs.msg import CalibrationProgress
from sl_msgs.srv import ComputeCalibration, ListSamples

POSE_KEYS = {
    HAND_EYE_FILE: HAND_EYE_KEY,
    PROJECTOR_POSE_FILE: PROJECTOR_POSE_KEY,
    PAIR_FILE: PAIR_KEY,
}


def suggestion(pose: NDArray[np.float64] | None) -> Pose:
    """Return a suggested flange pose as a message; a zero quaternion says that there is none."""
    if pose is None:
        return Pose(orientation=Quaternion(x=0.0, y=0.0, z=0.0, w=0.0))
    return pose_message(pose)


def fill(response: ComputeCalibration.Response, outcome: Outcome, session: Session) -> None:
    """Fill the answer of ~/compute."""
    response.success, response.message = True, outcome.message
    response.samples = len(outcome.residuals)
    response.rms, response.rms_left_out = outcome.rms, outcome.rms_left_out
    known = {name: value for name, value in outcome.residuals.items() if np.isfinite(value)}
    if known:
        worst = max(known, key=lambda name: known[name])
        response.worst_sample = [sample.name for sample in session.samples].index(worst)
        response.worst_rms = float(known[worst])
    response.hand_eye_sigma = outcome.hand_eye_sigma.astype(np.float32)
    response.projector_sigma = outcome.projector_sigma.astype(np.float32)


def list_samples(
    response: ListSamples.Response, session: Session, procedure: Procedure, outcome: Outcome | None
) -> ListSamples.Response:
    """Fill the answer of ~/list_samples."""
    residuals = outcome.residuals if outcome is not None else {}
    response.session = str(session.folder)
    response.index = list(range(len(session)))
    response.stamp = [from_ns(sample.stamp) for sample in session.samples]
    response.points = [procedure.points(sample) for sample in session.samples]
    response.residual = [residuals.get(sample.name, float("nan")) for sample in session.samples]
    return response


def describe_files(folder: Path, names: Sequence[str]) -> str:
    """Read the calibration files of a folder and say what they are; raises CalibrationFileError for one that is not
    usable."""
    for name in names:
        read = {CAMERA_FILE: load_camera, PROJECTOR_FILE: load_camera}.get(name)
        if read is not None:
            read(folder / name)
        elif name in POSE_KEYS:
            load_pose(folder / name, POSE_KEYS[name])
    extra = read_yaml(folder / names[-1])
    return (
        f"calibration of {extra.get('date', 'unknown date')} from {extra.get('samples', '?')} samples,"
        f" residuals {extra.get('residuals', 'unknown')}"
    )


def progress(
    header: Header,
    session: Session,
    procedure: Procedure,
    covered: Coverage,
    outcome: Outcome | None,
    suggested: Pose,
) -> CalibrationProgress:
    """Return the message of ~/progress."""
    return CalibrationProgress(
        header=header,
        procedure=procedure.name,
        session=str(session.folder),
        samples=len(session),
        samples_needed=procedure.samples_needed,
        coverage_image=covered.image,
        coverage_rotation=covered.rotation,
        coverage_depth=covered.depth,
        computed=outcome is not None,
        message=covered.message if outcome is None else outcome.message,
        suggested=suggested,
    )
