"""One order to the arm, from acceptance to its outcome."""

import threading
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from arm_positioner.errors import Code

Array = NDArray[np.float64]


class Kind(Enum):
    """Where the target comes from."""

    POSE = "pose"  # given once
    OBJECT = "object"  # from the point cloud
    SERVO = "servo"  # a stream of targets


@dataclass(frozen=True)
class Outcome:
    """How a task ended: status code and one sentence with the numbers."""

    code: Code
    message: str


class Task:
    """An order in execution.

    Attributes:
        kind: Where the target comes from.
        target: (4, 4) base_from_camera wanted [m].
        goal: (n,) joint positions wanted [rad or m].
        follow: Whether the target keeps changing until cancelled.
        target_time: When the target was last confirmed by a cloud or a message [s].
        held: Why the arm waits at rest though the task goes on; None: it does not.
        held_since: When the waiting began [s].
        arrive_at: When the motion to the target was to end [s]; keeps a slow approach slow while its target changes.
        remaining: What was left of it when the arm was paused or held [s].
        rest_since: When the last setpoint towards the goal left [s]; None: still moving.
        outcome: None until the task has ended and the arm is at rest.
    """

    def __init__(self, kind: Kind, target: Array, goal: Array, *, follow: bool, time: float) -> None:
        self.kind, self.follow = kind, follow
        self.target, self.goal = target, goal
        self.target_time = time
        self.held: Outcome | None = None
        self.held_since = 0.0
        self.arrive_at = -np.inf
        self.remaining = 0.0
        self.rest_since: float | None = None
        self.outcome: Outcome | None = None
        self._done = threading.Event()

    @property
    def tracks(self) -> bool:
        """Whether the goal changes while the task runs."""
        return self.follow or self.kind is Kind.SERVO

    def finish(self, outcome: Outcome) -> None:
        """End the task; the first outcome counts."""
        if self.outcome is None:
            self.outcome = outcome
            self._done.set()

    def wait(self, timeout: float) -> bool:
        """Wait at most ``timeout`` [s] for the end; returns whether it has come."""
        return self._done.wait(timeout)
