"""The simulated robot driver: a stream of setpoints in, joint motion out, at a fixed rate.

Each received setpoint stands for one control period. A short queue takes up the jitter of their arrival: a stream is
followed once a few setpoints wait (or the first has waited that long), then one is consumed every period. When the
queue
runs empty the arm holds the last setpoint, as a servo would.
"""

from collections import deque
from dataclasses import asdict, dataclass

import numpy as np

from sl_common.errors import InvalidInputError
from sl_sim.arm import JointLimits, Servo
from sl_sim.violations import ViolationCounter


@dataclass
class StreamCounts:
    """What happened to the streams, apart from limits.

    Attributes:
        streams: streams begun. first_setpoint_jumps: begun farther than `jump` from the measured joints;
            largest_jump [rad].
        gaps: times the queue ran empty in the midst of a motion. stopped_while_moving: streams that ended
            without coming to rest. refused: messages that were no setpoint. dropped: setpoints beyond the queue's size.
    """

    streams: int = 0
    first_setpoint_jumps: int = 0
    largest_jump: float = 0.0
    gaps: int = 0
    stopped_while_moving: int = 0
    refused: int = 0
    dropped: int = 0


class ArmDriver:
    """Follows setpoints and judges them.

    Attributes:
        servo: the true joints. counter: limit violations. counts: see StreamCounts.
    """

    def __init__(
        self,
        limits: JointLimits,
        start: np.ndarray,
        *,
        period: float = 0.008,
        buffer: float = 0.04,
        timeout: float = 0.3,
        jump: float = 2e-3,
        longest: float = 2.0,
        bandwidth: float = 80.0,
    ) -> None:
        """At rest at `start` (n,).

        Args:
            limits: of the joints. period: control period [s]. buffer: time that a stream waits in the queue [s].
            timeout: pause [s] after which a stream has ended and the next setpoint begins another.
            jump: largest allowed distance of a stream's first setpoint from the joints [rad]. longest: queue [s].
            bandwidth: of the servo [rad/s].
        """
        self.limits, self.period = limits, period
        self._wait, self._longest = round(buffer / period), round(longest / period)
        self._timeout, self._jump = round(timeout / period), jump
        self.servo = Servo(start, bandwidth)
        self.reset(start)

    def reset(self, start: np.ndarray) -> None:
        """At rest at `start` (n,), nothing queued, all counts zero."""
        self.servo.reset(start)
        self.counter = ViolationCounter(self.limits, self.period)
        self.counts = StreamCounts()
        self._queue: deque[np.ndarray] = deque()
        self._reference = np.array(start, float)
        self._following = False
        self._age = self._idle = 0
        self._streaming = False

    def receive(self, positions: np.ndarray) -> tuple[str, ...]:
        """Queue one setpoint (n,) [rad]; returns the kinds of limits it violates. Raises InvalidInputError when it
        is unusable.
        """
        positions = np.array(positions, float)
        if positions.shape != (len(self.limits.names),):
            self.counts.refused += 1
            raise InvalidInputError(
                f"setpoint has {positions.size} values, the arm has {len(self.limits.names)} joints"
            )
        if not np.isfinite(positions).all():
            self.counts.refused += 1
            self.counter.found.counts["not_finite"] += 1
            bad = [n for n, x in zip(self.limits.names, positions, strict=True) if not np.isfinite(x)]
            raise InvalidInputError(f"setpoint is not finite for {', '.join(bad)}")
        if not self._streaming:
            self._streaming = True
            self.counts.streams += 1
            distance = float(np.abs(positions - self.servo.positions).max())
            self.counts.largest_jump = max(self.counts.largest_jump, distance)
            self.counts.first_setpoint_jumps += distance > self._jump
            self.counter.start(positions)
            self._age = 0
        self._idle = 0
        if len(self._queue) >= self._longest:
            self._queue.popleft()
            self.counts.dropped += 1
        self._queue.append(positions)
        return self.counter.add(positions)

    def refuse(self) -> None:
        """Count a message that was no setpoint."""
        self.counts.refused += 1

    def step(self) -> np.ndarray:
        """One control period; returns the true joint positions (n,) at its end."""
        if self._queue and not self._following:
            self._age += 1
            self._following = len(self._queue) > self._wait or self._age > self._wait
        if self._following and self._queue:
            self._reference = self._queue.popleft()
        elif self._following:
            self._following, self._age = False, 0
            self.counts.gaps += self.counter.moving
        if self._streaming and not self._queue:
            self._idle += 1
            if self._idle > self._timeout:
                self._streaming = False
                self.counts.stopped_while_moving += self.counter.moving
        self.servo.follow(self._reference, self.period)
        return self.servo.positions

    @property
    def reference(self) -> np.ndarray:
        """(n,) the setpoint being followed."""
        return self._reference

    def report(self) -> dict[str, object]:
        """All counts as plain types."""
        found = self.counter.found
        return {
            "setpoints": found.setpoints,
            "violations": dict(found.counts),
            "violations_total": found.total,
            "worst": {kind: round(value, 6) for kind, value in found.worst.items()},
            **asdict(self.counts),
        }
