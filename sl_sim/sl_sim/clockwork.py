"""Keeps the cell's time: control periods, the history of the true joints, and when the shutter opens."""

from collections import deque

import numpy as np

from sl_common.errors import InvalidInputError
from sl_sim.driver import ArmDriver

_NS = 1_000_000_000


class Clockwork:
    """Steps the driver in fixed periods along a clock given from outside, and remembers the joints.

    Args:
        driver: the arm. start: time [ns] of the first state. history: states kept.
    """

    def __init__(self, driver: ArmDriver, start: int, history: int = 500) -> None:
        self.driver = driver
        self._period = round(driver.period * _NS)
        self._states: deque[tuple[int, np.ndarray]] = deque(maxlen=history)
        self._states.append((start, driver.servo.positions.copy()))
        self.skipped = 0.0

    @property
    def now(self) -> int:
        """Time [ns] of the newest state."""
        return self._states[-1][0]

    @property
    def oldest(self) -> int:
        """Time [ns] of the oldest state."""
        return self._states[0][0]

    @property
    def positions(self) -> np.ndarray:
        """(n,) the newest true joint positions."""
        return self._states[-1][1]

    def advance(self, clock: int, longest: int = _NS) -> list[tuple[int, np.ndarray]]:
        """Step every period up to clock [ns]; returns the new states (time [ns], positions (n,)).

        A clock that jumps ahead by more than `longest` [ns] (a suspended process) is followed without stepping.
        """
        if clock - self.now > longest:
            self.skipped += (clock - self.now) / _NS
            self._states.append((clock, self.positions))
            return [self._states[-1]]
        new = []
        while self.now + self._period <= clock:
            self._states.append((self.now + self._period, self.driver.step().copy()))
            new.append(self._states[-1])
        return new

    def at(self, times: np.ndarray) -> np.ndarray:
        """(k, n) true joint positions at times (k,) [ns], linear between states. Raises InvalidInputError outside
        the history.
        """
        stamps = np.array([stamp for stamp, _ in self._states])
        if times.min() < stamps[0] or times.max() > stamps[-1]:
            raise InvalidInputError("that time is not in the history of the joints")
        positions = np.array([q for _, q in self._states])
        k = np.clip(np.searchsorted(stamps, times, side="right"), 1, len(stamps) - 1)
        share = (times - stamps[k - 1]) / (stamps[k] - stamps[k - 1])
        return positions[k - 1] + share[:, None] * (positions[k] - positions[k - 1])
