"""How far a joint still travels when it is brought to rest as fast as acceleration and jerk limits allow.

Closed form of the time-optimal stop of a jerk-limited joint, apart from the trajectory generator on purpose: the
planner uses it to keep every state stoppable before a position limit, the guard to verify that.
"""

import numpy as np
from numpy.typing import NDArray

from arm_positioner.limits import JointLimits

Array = NDArray[np.float64]


def stopping_range(position: Array, velocity: Array, acceleration: Array, limits: JointLimits) -> tuple[Array, Array]:
    """Return the lowest and highest positions (..., n) [rad or m] on the way to rest from states (..., n).

    The stop drives velocity and acceleration to zero in minimum time, each joint by itself.

    Args:
        position: (..., n) [rad or m].
        velocity: (..., n) [rad/s or m/s].
        acceleration: (..., n) [rad/s^2 or m/s^2], within the limits.
        limits: Acceleration and jerk limits.
    """
    peak, jerk = limits.acceleration, limits.jerk
    # The velocity left when the acceleration alone is taken back decides the direction; mirrored to be positive.
    left = velocity + acceleration * np.abs(acceleration) / (2 * jerk)
    sign = np.where(left < 0, -1.0, 1.0)
    v, a = sign * velocity, sign * acceleration
    lowest_a = np.sqrt(np.maximum(jerk * v + 0.5 * a * a, 0.0))  # magnitude of the deceleration's peak
    flat = np.maximum((v + a * a / (2 * jerk) - peak * peak / jerk) / peak, 0.0)  # time at constant deceleration
    low = np.minimum(lowest_a, peak)
    t1, t3 = (a + low) / jerk, low / jerk
    v1 = v + a * t1 - 0.5 * jerk * t1**2
    d1 = v * t1 + 0.5 * a * t1**2 - jerk * t1**3 / 6
    d2 = v1 * flat - 0.5 * low * flat**2
    v2 = v1 - low * flat
    d3 = v2 * t3 - 0.5 * low * t3**2 + jerk * t3**3 / 6
    end = d1 + d2 + d3
    # Where the joint still moves backwards (v < 0 < a) it turns round first.
    turn = np.where(v < 0, (a - np.sqrt(np.maximum(a * a + 2 * jerk * v, 0.0))) / jerk, 0.0)
    back = np.where(v < 0, v * turn + 0.5 * a * turn**2 - jerk * turn**3 / 6, 0.0)
    first = position + sign * np.minimum(back, np.minimum(end, 0.0))
    last = position + sign * np.maximum(end, 0.0)
    return np.minimum(first, last), np.maximum(first, last)
