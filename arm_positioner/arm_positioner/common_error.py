"""What an error that all points have in common, such as the calibration's, does to a surface's place and normal."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_STEP = 1e-3
"""Way along the surface over which the change of the error is taken [m]."""
_LEAST_SINE = 1e-3
"""Of the angle between the rays; below, there is no depth at all."""


def common_covariance(
    point: Array, normal: Array, tangents: Array, camera: Array, projector: Array, sigma: float
) -> Array:
    """Return the covariance (3, 3) of height [m] and tilts [rad] that rays which pass each other by ``sigma`` make.

    Where the rays of camera and projector meet at an angle a, an error d across them is one of d / sin(a) along them.
    From dot to dot the angle changes, and with it this error: the surface is tilted by its gradient, and by that of d
    itself, which is as large as an error of d at the camera's distance turns the ray. Both grow fast where the
    camera looks along the light.

    Args:
        point: (3,) on the surface [m].
        normal: (3,) unit normal.
        tangents: (2, 3) along which tilts are counted.
        camera: (3,) its position [m].
        projector: (3,) its position [m].
        sigma: Standard deviation of the error across the rays [m].
    """

    def height(at: Array) -> float:
        sight, light = camera - at, projector - at
        distance = float(np.linalg.norm(sight))
        sine = np.linalg.norm(np.cross(sight, light)) / (distance * np.linalg.norm(light))
        return sigma * abs(float(normal @ sight)) / distance / max(float(sine), _LEAST_SINE)

    slopes = [(height(point + _STEP * t) - height(point - _STEP * t)) / (2 * _STEP) for t in tangents]
    errors = np.array([height(point), *slopes])
    turned = errors[0] / float(np.linalg.norm(camera - point))
    return np.outer(errors, errors) + np.diag([0.0, turned**2, turned**2])
