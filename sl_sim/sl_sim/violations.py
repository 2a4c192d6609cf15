"""Counts how often a stream of setpoints leaves the joints' limits."""

from dataclasses import dataclass, field

import numpy as np

from sl_sim.arm import JointLimits

KINDS = ("position", "velocity", "acceleration", "jerk")
_EPSILON = np.finfo(float).eps


@dataclass
class Violations:
    """Setpoints outside each limit, and the largest value over its limit (1 = at the limit).

    A setpoint counts once per kind, however many of its joints are outside.
    """

    counts: dict[str, int] = field(default_factory=lambda: {**dict.fromkeys(KINDS, 0), "not_finite": 0})
    worst: dict[str, float] = field(default_factory=lambda: dict.fromkeys(KINDS, 0.0))
    setpoints: int = 0

    @property
    def total(self) -> int:
        """All violations."""
        return sum(self.counts.values())


class ViolationCounter:
    """Judges each setpoint of a stream by finite differences over the nominal period.

    Velocity, acceleration and jerk are first, second and third differences of the received positions, which are
    means of
    the true derivatives over one to three periods: a stream sampled from a motion within the limits never exceeds
        them. The only
    allowance is the rounding of the positions themselves (a few units in the last place of a double, divided by the
    period's power).
    """

    def __init__(self, limits: JointLimits, period: float) -> None:
        """limits of the joints; period [s] between setpoints."""
        self._limits, self._period = limits, period
        self.found = Violations()
        self._history = np.zeros((4, len(limits.names)))

    def start(self, positions: np.ndarray) -> None:
        """A new stream from rest at its first setpoint (n,)."""
        self._history = np.tile(np.asarray(positions, float), (4, 1))

    @property
    def moving(self) -> bool:
        """Holding the last setpoint from now on would violate the acceleration or jerk limits."""
        held = np.vstack([np.tile(self._history[0], (3, 1)), self._history[1:]])
        acceleration, jerk = (np.diff(held, n, axis=0) / self._period**n for n in (2, 3))
        limits = self._limits
        return bool((np.abs(acceleration) > limits.acceleration).any() or (np.abs(jerk) > limits.jerk).any())

    def add(self, positions: np.ndarray) -> tuple[str, ...]:
        """Take the next setpoint (n,); returns the kinds of limits that it violates."""
        found, limits = self.found, self._limits
        found.setpoints += 1
        if not np.isfinite(positions).all():
            found.counts["not_finite"] += 1
            return ("not_finite",)
        self._history = np.vstack([positions, self._history[:3]])
        q0, q1, q2, q3 = self._history
        size = np.maximum(np.abs(self._history).max(0), 1.0) * _EPSILON
        t = self._period
        middle, half = 0.5 * (limits.upper + limits.lower), 0.5 * (limits.upper - limits.lower)
        cases = (
            ("position", q0 - middle, half, 2 * size),
            ("velocity", (q0 - q1) / t, limits.velocity, 4 * size / t),
            ("acceleration", (q0 - 2 * q1 + q2) / t**2, limits.acceleration, 8 * size / t**2),
            ("jerk", (q0 - 3 * q1 + 3 * q2 - q3) / t**3, limits.jerk, 16 * size / t**3),
        )
        outside = []
        for kind, value, limit, rounding in cases:
            found.worst[kind] = max(found.worst[kind], float((np.abs(value) / limit).max()))
            if (np.abs(value) > limit + rounding).any():
                found.counts[kind] += 1
                outside.append(kind)
        return tuple(outside)
