"""Time-stamped poses from CSV files: t,x,y,z,qx,qy,qz,qw, with or without a header."""

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sl_common import transforms
from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]

COLUMNS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
_FARTHEST = 20.0


@dataclass(frozen=True, eq=False)
class PoseStream:
    """Poses in the order of their stamps.

    Attributes:
        times: (N,) strictly increasing [s].
        poses: (N, 4, 4) [m].
        rows: (N,) line of each pose in its file, from 1, for messages.
    """

    times: Array
    poses: Array
    rows: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.times)

    @property
    def period(self) -> float:
        """Typical time between poses [s]."""
        return float(np.median(np.diff(self.times))) if len(self.times) > 1 else float("inf")

    def at(self, times: Array) -> Array:
        """Return interpolated poses (K, 4, 4) at times (K,) within the stream; outside, the nearest end."""
        times = np.clip(times, self.times[0], self.times[-1])
        left = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        share = (times - self.times[left]) / (self.times[left + 1] - self.times[left])
        return transforms.interpolate(self.poses[left], self.poses[left + 1], share)

    def gap(self, times: Array) -> Array:
        """Return for times (K,) the distance between the poses before and after [s]; 0 at a pose, inf outside."""
        right = np.searchsorted(self.times, times, side="left")
        inside = (times >= self.times[0]) & (times <= self.times[-1])
        right = np.clip(right, 1, len(self.times) - 1)
        exact = np.isclose(self.times[right], times, rtol=0, atol=1e-6)
        exact |= np.isclose(self.times[right - 1], times, rtol=0, atol=1e-6)
        gap = np.where(exact, 0.0, self.times[right] - self.times[right - 1])
        return np.where(inside | exact, gap, np.inf)


def load_poses(path: str | os.PathLike[str]) -> PoseStream:
    """Read a stream; rows are sorted by time, of rows with the same stamp the first is kept.

    Raises:
        InvalidInputError: no such file, a row that is not eight numbers, a zero quaternion, fewer than two poses, or
            positions so far out that they are surely not metres.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except FileNotFoundError:
        raise InvalidInputError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInputError(f"{path}: cannot be read: {error}") from None
    values: list[list[float]] = []
    rows: list[int] = []
    for number, line in enumerate(lines, start=1):
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        try:
            row = [float(field) for field in text.split(",")]
        except ValueError:
            if not values:  # a header
                continue
            raise InvalidInputError(f"{path}: line {number} is not eight numbers {','.join(COLUMNS)}") from None
        if len(row) != len(COLUMNS) or not np.all(np.isfinite(row)):
            raise InvalidInputError(f"{path}: line {number} is not eight finite numbers {','.join(COLUMNS)}")
        if abs(np.linalg.norm(row[4:]) - 1) > 0.1:
            raise InvalidInputError(
                f"{path}: line {number}: quaternion of norm {np.linalg.norm(row[4:]):.3g}, expected 1; columns are"
                f" {','.join(COLUMNS)}"
            )
        values.append(row)
        rows.append(number)
    return make_stream(np.array(values).reshape(-1, len(COLUMNS)), np.array(rows, dtype=np.int64), str(path))


def make_stream(values: Array, rows: NDArray[np.int64] | None = None, name: str = "poses") -> PoseStream:
    """Make a stream of rows (N, 8) of t [s], position [m], quaternion xyzw. Raises InvalidInputError as load_poses
    does."""
    rows = np.arange(1, len(values) + 1) if rows is None else rows
    if len(values) < 2:
        raise InvalidInputError(f"{name}: too few poses: {len(values)}")
    farthest = float(np.abs(values[:, 1:4]).max())
    if farthest > _FARTHEST:
        raise InvalidInputError(
            f"{name}: a position of {farthest:g} m (line {rows[np.argmax(np.abs(values[:, 1:4]).max(1))]}): mixed"
            f" units?"
            " Positions are in metres"
        )
    order = np.argsort(values[:, 0], kind="stable")
    values, rows = values[order], rows[order]
    first = np.concatenate([[True], np.diff(values[:, 0]) > 1e-9])
    values, rows = values[first], rows[first]
    if len(values) < 2:
        raise InvalidInputError(f"{name}: all poses have the stamp {values[0, 0]:g}")
    return PoseStream(values[:, 0], transforms.from_quaternion(values[:, 1:4], values[:, 4:]), rows)
