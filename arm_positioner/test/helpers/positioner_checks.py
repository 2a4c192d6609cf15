"""What every stream of setpoints has to satisfy."""

import numpy as np

from arm_positioner.limits import JointLimits


def limit_violations(setpoints: np.ndarray, limits: JointLimits, period: float, tolerance: float = 1e-6) -> list[str]:
    """Return what is wrong with setpoints (N, n), one period apart, that begin and end at rest.

    Velocity, acceleration and jerk are differences of the positions, as a driver sees them.
    """
    if not np.isfinite(setpoints).all():
        return ["not finite"]
    p = np.concatenate([np.repeat(setpoints[:1], 3, axis=0), setpoints, np.repeat(setpoints[-1:], 3, axis=0)])
    found = []
    if (p < limits.lower - 1e-9).any() or (p > limits.upper + 1e-9).any():
        found.append("position")
    derivative = p
    for name in ("velocity", "acceleration", "jerk"):
        derivative = np.diff(derivative, axis=0) / period
        ratio = float(np.abs(derivative / getattr(limits, name)).max())
        if ratio > 1 + tolerance:
            found.append(f"{name} {ratio:.6f} of its limit")
    return found
