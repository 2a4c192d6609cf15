"""The figures of a run as a table."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

MAX_POSITION_ERROR = 0.002
"""[m] by which the demo passes or fails."""
MAX_ORIENTATION_ERROR = np.radians(0.5)
"""[rad]"""


@dataclass(frozen=True)
class Row:
    """One figure.

    Attributes:
        name: What it is.
        value: The number; NaN fails any limit.
        unit: Of value and limit.
        limit: Greatest value that passes; None: for information.
        least: The limit is the least value instead.
        digits: Digits after the point.
    """

    name: str
    value: float
    unit: str = ""
    limit: float | None = None
    least: bool = False
    digits: int = 2

    @property
    def passed(self) -> bool | None:
        """Whether the value keeps its limit; None without one."""
        if self.limit is None:
            return None
        return bool(self.value >= self.limit if self.least else self.value <= self.limit)

    def cells(self) -> tuple[str, str, str, str, str]:
        """Return name, value, unit, limit and verdict as text."""
        number = "-" if np.isnan(self.value) else f"{self.value:.{self.digits}f}"
        limit = "" if self.limit is None else f"{'>=' if self.least else '<='} {self.limit:g}"
        verdict = {None: "", True: "ok", False: "FAILED"}[self.passed]
        return self.name, number, self.unit, limit, verdict

    def as_dict(self) -> dict[str, object]:
        """Return the row for JSON; NaN becomes null."""
        value = None if np.isnan(self.value) else float(self.value)
        return {"name": self.name, "value": value, "unit": self.unit, "limit": self.limit, "ok": self.passed}


def passed(rows: Sequence[Row]) -> bool:
    """Tell whether no row fails."""
    return all(row.passed is not False for row in rows)


def table(rows: Sequence[Row]) -> str:
    """Return rows as aligned text with a header."""
    cells = [("", "value", "unit", "limit", ""), *(row.cells() for row in rows)]
    widths = [max(len(c[i]) for c in cells) for i in range(5)]
    lines = [
        f"{name:<{widths[0]}}  {value:>{widths[1]}} {unit:<{widths[2]}}  {limit:<{widths[3]}}  {verdict}".rstrip()
        for name, value, unit, limit, verdict in cells
    ]
    return "\n".join([lines[0], "-" * max(map(len, lines)), *lines[1:]])
