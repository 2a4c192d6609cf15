"""Nearest neighbours of points in the plane, by buckets."""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.compiled import compiled

PER_CELL = 5.5  # points in a cell on average: three by three of them hold twelve nearest neighbours of a lattice's dot
MOST = 12  # neighbours that can be found
LANES = 8  # points of a cell whose neighbours are found side by side
X, Y, SELF = MOST * LANES, (MOST + 1) * LANES, (MOST + 2) * LANES  # where the lanes' points and their numbers are
NOBODY = np.int32(0x7F7FFFFF)  # a key beyond those of all candidates
FAR = np.float32(1e18)  # a distance whose square is a number still


@compiled
def _buckets(points, x0, y0, scale, nx, ny):
    """Points sorted by cell: begin of each cell (nx * ny + 1,), indices, x and y (N,) in that order."""
    n = len(points)
    begin = np.zeros(nx * ny + 1, np.int32)
    cell = np.empty(n, np.int32)
    for i in range(n):
        cell[i] = int((points[i, 1] - y0) * scale) * nx + int((points[i, 0] - x0) * scale)
        begin[cell[i] + 1] += 1
    for c in range(nx * ny):
        begin[c + 1] += begin[c]
    fill = begin[:-1].copy()
    members = np.empty(n, np.int32)
    xs = np.empty(n, np.float32)
    ys = np.empty(n, np.float32)
    for i in range(n):
        f = fill[cell[i]]
        fill[cell[i]] += 1
        members[f] = i
        xs[f] = points[i, 0]
        ys[f] = points[i, 1]
    return begin, members, xs, ys


@compiled
def nearest(points, k):
    """Indices (N, k) int32 of the k <= MOST nearest other points of points (N, 2) float32, by distance.

    -1 where there are fewer. Of points whose distances differ by less than 1 in 10,000 any may come first. Raises
    ValueError for a larger k.
    """
    if k > MOST:
        raise ValueError("more neighbours are asked for than the lists of a cell hold: at most MOST")
    n = len(points)
    out = np.full((n, k), -1, np.int32)
    if n < 2:
        return out
    x0, y0 = points[:, 0].min(), points[:, 1].min()
    x1, y1 = points[:, 0].max(), points[:, 1].max()
    cell = np.float32(max(np.sqrt((x1 - x0 + 1.0) * (y1 - y0 + 1.0) * PER_CELL / n), 1.0))
    scale = np.float32(1) / cell
    nx = int((x1 - x0) * scale) + 1
    ny = int((y1 - y0) * scale) + 1
    begin, members, xs, ys = _buckets(points, x0, y0, scale, nx, ny)
    place = np.empty(n, np.int32)
    around = np.empty((2, n), np.float32)
    lists = np.empty((MOST + 3) * LANES, np.int32)
    for c in range(nx * ny):
        first, last = begin[c], begin[c + 1]
        cx, cy = c % nx, c // nx
        ring = 1
        while first < last:
            left, right = max(cx - ring, 0), min(cx + ring + 1, nx)
            top, bottom = max(cy - ring, 0), min(cy + ring + 1, ny)
            total = _gather(begin, nx, left, right, top, bottom, xs, ys, place, around)
            # nothing outside of what is searched is nearer than its border; beyond the outermost cells is nothing
            x_low = x0 + np.float32(left) * cell if left > 0 else -FAR
            x_high = x0 + np.float32(right) * cell if right < nx else FAR
            y_low = y0 + np.float32(top) * cell if top > 0 else -FAR
            y_high = y0 + np.float32(bottom) * cell if bottom < ny else FAR
            whole = True
            while whole and first < last:
                lanes = min(LANES, last - first)
                number = np.searchsorted(place[:total], first)
                for lane in range(LANES):
                    q = first + min(lane, lanes - 1)
                    lists[X + lane] = np.float32(xs[q]).view(np.int32)
                    lists[Y + lane] = np.float32(ys[q]).view(np.int32)
                    lists[SELF + lane] = number + lane
                mask = _rank(lists, around[0, :total], around[1, :total])
                for lane in range(lanes):
                    x, y = xs[first + lane], ys[first + lane]
                    gap = min(min(x - x_low, x_high - x), min(y - y_low, y_high - y))
                    furthest = lists[(k - 1) * LANES + lane] | mask
                    whole &= gap >= FAR or furthest <= np.float32(gap * gap).view(np.int32)
                for lane in range(lanes if whole else 0):
                    to = out[members[first + lane]]
                    for p in range(k):
                        key = lists[p * LANES + lane]
                        to[p] = members[place[key & mask]] if key != NOBODY else -1
                first += lanes if whole else 0
            ring += 1
    return out


@compiled
def _gather(begin, nx, left, right, top, bottom, xs, ys, place, around):
    """Points of a block of cells, one behind the other: place (M,) where they are, around (2, M); returns M."""
    total = 0
    for row in range(top * nx, bottom * nx, nx):
        first, end = begin[row + left], begin[row + right]
        for q in range(end - first):
            place[total + q] = first + q
            around[0, total + q] = xs[first + q]
            around[1, total + q] = ys[first + q]
        total += end - first
    return total


@compiled
def _rank(lists, xs, ys):
    """Sort the candidates xs, ys (M,) float32 by their distances from each of LANES points.

    Writes the p-th key of a lane to lists[p * LANES + lane]. A key is the squared distance (positive floats keep their
    order as integers) with the candidate's number in its low bits, the mask of which is returned. All is in one array,
    and insertion has no branch: so the compiler makes vectors of the lanes.
    """
    mask = np.int32(1)
    while mask < len(xs):
        mask = np.int32(2 * mask + 1)
    lists[: MOST * LANES] = NOBODY
    for q in range(len(xs)):
        x, y = xs[q], ys[q]
        for lane in range(LANES):
            ex, ey = x - np.int32(lists[X + lane]).view(np.float32), y - np.int32(lists[Y + lane]).view(np.float32)
            distance = np.float32(ex * ex + ey * ey).view(np.int32)
            key = np.int32((distance & ~mask) | np.int32(q)) if lists[SELF + lane] != q else NOBODY
            _insert(key, lists, lane)
    return mask


@compiled
def _insert(key, lists, lane):
    """Insert a key among the sorted keys of a lane; the largest of them falls out."""
    for p in range(lane, lane + MOST * LANES, LANES):
        here = lists[p]
        lists[p] = key if key < here else here
        key = here if key < here else key
