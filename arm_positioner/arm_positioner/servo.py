"""When a stream of targets may move the arm."""


class ServoGate:
    """Keeps a stream that was stopped from starting the arm again by its next message.

    After a stop or a fault the targets are ignored until the stream has paused for ``silence`` seconds or the gate is
    opened: a new stream is a new order, the rest of the old one is not.
    """

    def __init__(self, silence: float = 1.0) -> None:
        self._silence = silence
        self._last = -float("inf")
        self._closed = False

    def close(self) -> None:
        """Ignore the present stream from now on."""
        self._closed = True

    def open(self) -> None:
        """Accept targets again."""
        self._closed = False

    def admits(self, time: float) -> bool:
        """Take the arrival [s] of a target and tell whether it may move the arm."""
        if time - self._last > self._silence:
            self._closed = False
        self._last = time
        return not self._closed
