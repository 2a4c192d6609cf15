"""The two grids as integer lattices: directions, windows and rotations in axial coordinates (u, v).

Square: u = column, v = row. Hexagonal: u = column, v = row - (column - (column odd)) / 2, so that the six neighbours
are (1,0), (0,1), (-1,1), (-1,0), (0,-1), (1,-1). Directions are ordered by angle from the projector's u towards its v
axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Lattice:
    """steps (D, 2) int32 of the directions; window (W, 2) int32 offsets, centre first, then the ring by angle;
    ring_shift: by how many places of the ring a rotation by one direction moves the window;
    turn (D, 2, 2) int32: matrices that rotate offsets by k directions."""

    steps: np.ndarray
    window: np.ndarray
    ring_shift: int
    turn: np.ndarray

    @property
    def directions(self) -> int:
        """Number of directions, which is the order of the rotation group: 4 or 6."""
        return len(self.steps)


def _build(steps: list[tuple[int, int]], ring: list[tuple[int, int]], quarter: list[list[int]]) -> Lattice:
    rotation = np.array(quarter, np.int32)
    turn = [np.eye(2, dtype=np.int32)]
    for _ in range(len(steps) - 1):
        turn.append(rotation @ turn[-1])
    return Lattice(
        steps=np.array(steps, np.int32),
        window=np.array([(0, 0), *ring], np.int32),
        ring_shift=len(ring) // len(steps),
        turn=np.array(turn, np.int32),
    )


SQUARE = _build(
    [(1, 0), (0, 1), (-1, 0), (0, -1)],
    [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)],
    [[0, -1], [1, 0]],
)
HEXAGONAL = _build(
    [(1, 0), (0, 1), (-1, 1), (-1, 0), (0, -1), (1, -1)],
    [(1, 0), (0, 1), (-1, 1), (-1, 0), (0, -1), (1, -1)],
    [[0, -1], [1, 1]],
)


def mirrored(u: np.ndarray, v: np.ndarray, *, hexagonal: bool) -> tuple[np.ndarray, np.ndarray]:
    """Axial coordinates as seen in a mirror: the projector's u axis reversed."""
    return (-u, v + u) if hexagonal else (-u, v)


def to_axial(row: np.ndarray, col: np.ndarray, *, hexagonal: bool) -> tuple[np.ndarray, np.ndarray]:
    """Axial (u, v) of pattern elements."""
    if not hexagonal:
        return col, row
    return col, row - (col - (col & 1)) // 2


def from_axial(u: np.ndarray, v: np.ndarray, *, hexagonal: bool) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of axial coordinates."""
    if not hexagonal:
        return v, u
    return v + (u - (u & 1)) // 2, u
