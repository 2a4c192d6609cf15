"""The paper's neighbour graph (section III.B): expectation maximisation on the histogram of orientations.

Dot by dot, the orientations to the nearest neighbours and to the next ones (the diagonals) are taken, modulo the
lattice's symmetry. A mixture of two components over their histogram finds the direction of either kind, and with them
the angle that separates them; each dot is then linked to the nearest dot in every expected direction. One pair of
directions holds for the whole image, so this is worse than the local bases of `graph` where surfaces bend or differ,
and better where noise hides many dots of a plane: it serves as a second opinion on what the local bases left. Of its
links those are taken that are sides of cells of the lattice.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sl_decoder.compiled import compiled

BINS = 90  # of the histogram, over one period of the lattice's symmetry
STEPS = 40  # most iterations
SETTLED = 1e-3  # largest change of a membership at which it has converged


def separate(histogram: NDArray[np.float64]) -> tuple[float, float]:
    """Mean phases [rad] of two von Mises components over a histogram.

    histogram (2, B): counts of the nearest (0) and of the next neighbours (1) over one period, which start the
    memberships; from there on only their sum counts.
    """
    total = histogram.sum(0)
    phase = (np.arange(histogram.shape[1]) + 0.5) * 2 * np.pi / histogram.shape[1]
    member = histogram / np.maximum(total, 1e-9)
    mean = np.zeros(2)
    for _ in range(STEPS):
        weight = member * total
        number = np.maximum(weight.sum(1), 1e-9)
        moment = (weight * np.exp(1j * phase)).sum(1) / number
        mean, length = np.angle(moment), np.clip(np.abs(moment), 0, 0.99)
        concentration = length * (2 - length**2) / (1 - length**2)
        height = concentration[:, None] * np.cos(phase - mean[:, None]) - np.log(np.i0(concentration))[:, None]
        likelihood = np.exp(height) * (number / number.sum())[:, None]
        before, member = member, likelihood / np.maximum(likelihood.sum(0), 1e-12)
        if np.abs(member - before).max() < SETTLED:
            break
    return float(mean[0]), float(mean[1])


def links(
    points: NDArray[np.float32], shape: NDArray[np.float32], near: NDArray[np.int32], directions: int
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Neighbours (N, D) int32 in the lattice's directions, -1 for none, and quality (N,) float32: how many are missing.

    points (N, 2) px; shape (N, 3) footprints, in whose metric angles are taken; near (N, K) int32 nearest dots or -1;
    directions: D, 4 or 6. The quality is infinite for dots with fewer than half of their neighbours. Links are mutual,
    and close a cell of the lattice.
    """
    n = len(points)
    trace = 1.0 / np.sqrt(shape[:, 0] + shape[:, 2] + 2.0)
    offset = points[near] - points[:, None]
    x = ((shape[:, 2:] + 1) * offset[..., 0] - shape[:, 1:2] * offset[..., 1]) * trace[:, None]
    y = (-shape[:, 1:2] * offset[..., 0] + (shape[:, :1] + 1) * offset[..., 1]) * trace[:, None]
    distance = np.where(near >= 0, np.hypot(x, y), np.inf)
    angle = np.arctan2(y, x)
    period = 2 * np.pi / directions
    order = np.argsort(distance, axis=1)[:, : 2 * directions]
    phase = np.take_along_axis(np.mod(angle, period), order, axis=1)
    known = np.isfinite(np.take_along_axis(distance, order, axis=1))
    histogram = np.stack(
        [
            np.histogram(phase[:, kind][known[:, kind]], BINS, (0, period))[0]
            for kind in (slice(None, directions), slice(directions, None))
        ]
    ).astype(np.float64)
    nearest, diagonal = (mean / directions for mean in separate(histogram))
    apart = np.mod(diagonal - nearest + period / 2, period) - period / 2
    turned = np.mod(angle - nearest + period / 2, 2 * np.pi)
    aside = np.abs(np.mod(turned, period) - period / 2)
    found = np.full((n, directions), -1, np.int32)
    for k in range(directions):
        here = np.where((turned // period == k) & (aside <= abs(apart) / 2), distance, np.inf)
        which = here.argmin(1)
        there = np.isfinite(here[np.arange(n), which])
        found[there, k] = near[there, which[there]]
    missing = (found < 0).sum(1)
    return closed(found), np.where(2 * missing <= directions, missing, np.inf).astype(np.float32)


@compiled
def closed(links):
    """Links (N, D) int32 without those that close no cell of the lattice with their surroundings, on neither side.

    A link that skips a dot, or jumps over a depth edge, rarely does, and one of them is enough to give all beyond it
    wrong coordinates.
    """
    out = np.full_like(links, -1)
    for i in range(len(links)):
        for d in range(links.shape[1]):
            j = links[i, d]
            if j >= 0:
                back = _direction_to(links, j, i)
                if back >= 0 and _closes(links, i, d, j, back):
                    out[i, d] = j
    return out


@compiled
def _closes(links, i, d, j, back):
    """Whether the link from dot i in direction d to j, whose direction `back` leads to i, is the side of a cell.

    The cell's other dots are linked with either end; the cells of the hexagonal lattice are triangles.
    """
    directions = links.shape[1]
    half = directions // 2
    for turn in (1, -1):
        k = links[i, (d + turn) % directions]
        end = links[j, (back + half + turn * (half - 1)) % directions]
        if k >= 0 and end >= 0 and (k == end if directions == 6 else _direction_to(links, k, end) >= 0):
            return True
    return False


@compiled
def _direction_to(links, i, j):
    """Direction in which dot i is linked to dot j, or -1."""
    for d in range(links.shape[1]):
        if links[i, d] == j:
            return d
    return -1
