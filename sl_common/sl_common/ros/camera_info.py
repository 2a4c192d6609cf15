"""sensor_msgs/CameraInfo to and from camera models (REP-104)."""

import numpy as np
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError


def to_message(model: CameraModel, header: Header) -> CameraInfo:
    """Return a CameraInfo with the model as plumb_bob (a fit, for a Pers lens) and the real image size."""
    published = model.as_plumb_bob()
    projection = np.hstack([model.matrix, np.zeros((3, 1))])
    return CameraInfo(
        header=header,
        width=model.width,
        height=model.height,
        distortion_model="plumb_bob",
        d=list(published.coefficients),
        k=model.matrix.ravel().tolist(),
        r=np.eye(3).ravel().tolist(),
        p=projection.ravel().tolist(),
    )


def from_message(message: CameraInfo) -> CameraModel:
    """Return the camera model of a CameraInfo.

    Raises InvalidInputError for an uncalibrated camera (K all zero) or a distortion model that is not plumb_bob.
    """
    if not any(message.k):
        raise InvalidInputError("camera_info has K all zero: the camera is not calibrated; calibrate it first")
    matrix = np.array(message.k).reshape(3, 3)
    if message.distortion_model in ("", "none") or not any(message.d):
        return CameraModel(message.width, message.height, matrix)
    if message.distortion_model != "plumb_bob":
        raise InvalidInputError(
            f"camera_info has distortion model '{message.distortion_model}'; only plumb_bob is supported"
        )
    return CameraModel(message.width, message.height, matrix, "plumb_bob", tuple(message.d[:5]))
