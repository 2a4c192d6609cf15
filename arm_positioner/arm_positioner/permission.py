"""Who may begin a motion: only the newest order, not while paused, not after a stop, not while the node ends."""

from arm_positioner.errors import PausedError, SupersededError


class Permission:
    """Numbers orders and voids them.

    Attributes:
        paused: Whether ~/pause holds the arm; only ~/pause releases it.
        closed: Whether the node ends.
    """

    def __init__(self) -> None:
        self.paused = self.closed = False
        self._newest = 0

    def order(self) -> int:
        """Return the number of a new order; those before it that have not begun are void."""
        self._newest += 1
        return self._newest

    def void(self) -> None:
        """Void all orders that have not begun."""
        self._newest += 1

    def require(self, order: int) -> None:
        """Raise PausedError or SupersededError where an order must not begin."""
        if self.closed:
            raise PausedError("refused: the node is shutting down")
        if order != self._newest:
            raise SupersededError("not begun: a newer order or ~/stop came first")
        if self.paused:
            raise PausedError("refused: paused; call ~/pause with data: false first")
