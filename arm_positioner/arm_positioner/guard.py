"""The last check before a setpoint leaves: independent of how it was planned."""

import numpy as np
from numpy.typing import NDArray

from arm_positioner.limits import JointLimits
from arm_positioner.stopping import stopping_range
from arm_positioner.trajectory import MotionState

Array = NDArray[np.float64]


class SetpointGuard:
    """Compares each setpoint with the ones that left before it.

    Velocity, acceleration and jerk are the first, second and third differences of the positions over the control
    period, which is what a driver sees. The claimed velocity and acceleration have to agree with the differences,
    because a stop is planned from them, and a stop from the setpoint has to end inside the position limits.

    Attributes:
        last: The last accepted state; None before :meth:`reset`.
    """

    def __init__(self, limits: JointLimits, period: float, *, tolerance: float = 1e-4) -> None:
        """Check against ``limits`` every ``period`` [s], with a relative ``tolerance`` for rounding."""
        self._limits = limits
        self._period = period
        self._slack = 1.0 + tolerance
        self.last: MotionState | None = None
        self._history = np.zeros((3, limits.size))

    def reset(self, position: Array) -> None:
        """Begin a stream at rest at ``position`` (n,)."""
        self.last = MotionState.at_rest(position)
        self._history = np.tile(self.last.position, (3, 1))

    def violation(self, state: MotionState) -> str:
        """Say which limit ``state`` would break as the next setpoint, with the numbers; empty: none."""
        if self.last is None:
            return "no setpoint may leave before the stream has started"
        if not state.is_finite:
            return "setpoint is not finite"
        limits, dt = self._limits, self._period
        if reason := limits.outside(state.position, 1e-9):
            return reason
        p = np.vstack([self._history, state.position])
        velocity = np.diff(p, axis=0) / dt
        acceleration = np.diff(velocity, axis=0) / dt
        jerk = np.diff(acceleration, axis=0)[-1] / dt
        slack = self._slack
        checks = (
            ("velocity", velocity[-1], limits.velocity * slack),
            ("acceleration", acceleration[-1], limits.acceleration * slack),
            ("jerk", jerk, limits.jerk * slack + 1e-6),
            # differences lag the derivatives by half a period (velocity) and up to two periods (acceleration)
            ("claimed velocity error", state.velocity - velocity[-1], limits.acceleration * dt * slack),
            ("claimed acceleration error", state.acceleration - acceleration[-1], 2 * limits.jerk * dt * slack),
        )
        for name, values, allowed in checks:
            if (np.abs(values) > allowed).any():
                i = int(np.argmax(np.abs(values) / allowed))
                return f"joint {limits.names[i]}: {name} {values[i]:.6g} beyond {allowed[i]:.6g}"
        low, high = stopping_range(state.position, state.velocity, state.acceleration, limits)
        if reason := limits.outside(low, 1e-6) or limits.outside(high, 1e-6):
            return f"cannot be stopped in time: {reason}"
        return ""

    def accept(self, state: MotionState) -> None:
        """Record a setpoint that leaves."""
        self.last = state
        self._history = np.vstack([self._history[1:], state.position])
