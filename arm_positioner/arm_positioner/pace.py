"""How fast a motion may pass by a singularity, and where it has to stop."""

from collections.abc import Callable

from numpy import float64
from numpy.typing import NDArray

from arm_positioner.singularity import SingularityThresholds, SingularityWatch

_SPEED_STEP = 1.25
"""Ratio by which the speed factor near a singularity has to change before the motion is planned anew."""


class Pace:
    """The speed factor of the present motion.

    Attributes:
        speed: Factor on the velocity limits.
        thresholds: Of the condition number.
    """

    def __init__(self, thresholds: SingularityThresholds, condition: Callable[[NDArray[float64]], float]) -> None:
        """Judge joint positions (n,) by ``condition``, which returns their condition number."""
        self.thresholds, self._condition = thresholds, condition
        self.restart()

    def restart(self) -> None:
        """Begin another motion, at full speed."""
        self.speed = 1.0
        self.forget()

    def forget(self) -> None:
        """Forget how singular the arm was; the speed stays."""
        self._watch = SingularityWatch(self.thresholds)

    def look(self, position: NDArray[float64]) -> tuple[float, bool]:
        """Return the condition number at positions (n,) that the arm comes to, and whether it may be there."""
        condition = self._condition(position)
        return condition, self._watch.allows(condition)

    def change(self, condition: float) -> float | None:
        """Return the speed factor to plan anew with; None: the present one will do."""
        speed = self.thresholds.speed(condition)
        ratio = speed / self.speed
        if ratio < 1 / _SPEED_STEP or ratio > _SPEED_STEP or (speed == 1.0 and ratio != 1.0):
            return speed
        return None
