"""Nearest neighbours of points in the plane, by buckets."""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.compiled import compiled

PER_CELL = 5.5  # points in a cell on average: three by three of them hold sixteen nearest neighbours of a lattice's dot
LANES = 16  # candidates that are compared at once
MOST_RANKED = 96  # candidates up to which all are compared with all
SPARE = 12  # candidates beyond the number wanted that are ranked with them
FAR = np.float32(3e38)
FURTHEST = np.int32(0x7F7FFFFF)  # of the keys


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
    """Indices (N, k) int32 of the k nearest other points of points (N, 2) float32, by distance.

    -1 where there are fewer.
    """
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
    key = np.empty(n + LANES, np.int32)  # squared distances as integers: positive floats keep their order
    candidate = np.empty(n + LANES, np.int32)
    rank = np.empty(n + LANES, np.int32)
    chosen = np.empty(k, np.int32)
    within = np.float32(FAR)  # squared distance within which the neighbours of the last point lay
    for s in range(n):
        px, py = xs[s], ys[s]
        cx, cy = int((px - x0) * scale), int((py - y0) * scale)
        ring = 1
        while True:
            left, right, top, bottom = cx - ring, cx + ring, cy - ring, cy + ring
            # nothing outside of what is searched can be nearer than its border; beyond the outermost cells is nothing
            gap = FAR
            if left > 0:
                gap = min(gap, px - x0 - np.float32(left) * cell)
            if right < nx - 1:
                gap = min(gap, x0 + np.float32(right + 1) * cell - px)
            if top > 0:
                gap = min(gap, py - y0 - np.float32(top) * cell)
            if bottom < ny - 1:
                gap = min(gap, y0 + np.float32(bottom + 1) * cell - py)
            limit = gap * gap if gap < np.float32(1e18) else FAR
            total = 0
            for gy in range(max(0, top), min(ny, bottom + 1)):
                first, last = begin[gy * nx + max(0, left)], begin[gy * nx + min(nx - 1, right) + 1]
                for q in range(last - first):
                    ex, ey = xs[first + q] - px, ys[first + q] - py
                    d = ex * ex + ey * ey
                    key[total + q] = np.float32(d).view(np.int32)
                    candidate[total + q] = first + q
                if first <= s < last:
                    key[total + s - first] = FURTHEST
                total += last - first
            within = _radius(key, total, k, within, limit)
            m = _keep(key, candidate, total, within)
            if m >= k or gap == FAR:
                break
            ring += 1
        found = min(m, k)
        _choose(key, m, rank, chosen, found)
        for p in range(found):
            out[members[s], p] = members[candidate[chosen[p]]]
    return out


@compiled
def _radius(key, total, k, within, limit):
    """Squared distance (float32) up to `limit` within which `k` and a few more of key (total,) lie, or `limit`.

    within: where to try first. In the plane the number within a squared distance grows with that.
    """
    for _ in range(4):
        bound = min(within, limit)
        integer = np.float32(bound).view(np.int32)
        number = np.int32(0)
        for q in range(total):
            number += np.int32(key[q] <= integer)
        if k <= number <= k + SPARE or (number < k and bound == limit):
            return bound
        within = bound * (np.float32(k + SPARE // 2) / np.float32(max(number, np.int32(1))))
    return limit


@compiled
def _keep(key, candidate, total, within):
    """Keep of the first `total` keys and candidates, in place, those up to `within`; returns how many."""
    integer = np.float32(within).view(np.int32)
    m = 0
    for q in range(total):
        value = key[q]
        key[m] = value
        candidate[m] = candidate[q]
        m += np.int64(value <= integer)
    return m


@compiled
def _count_less(key, others, rank, first):
    """Count for each of LANES keys how many of LANES others are less; the first count starts from zero."""
    for i in range(LANES):
        less = np.int32(0)
        for j in range(LANES):
            less += np.int32(others[j] < key[i])
        rank[i] = less if first else rank[i] + less


@compiled
def _choose(key, m, rank, chosen, k):
    """Indices of the k least of key (m,) int32 in order, ties in theirs; writes chosen (k,).

    A key's rank is how many keys are less: counting has no branch that depends on the keys. With many candidates the
    least are picked one by one. rank (m,) int32: work space.
    """
    if m > MOST_RANKED:
        for p in range(k):
            best = 0
            for i in range(1, m):
                if key[i] < key[best]:
                    best = i
            chosen[p] = best
            key[best] = np.int32(0x7FFFFFFF)
        return
    blocks = (m + LANES - 1) // LANES
    for i in range(m, blocks * LANES):
        key[i] = np.int32(0x7FFFFFFF)
    keys = key[: blocks * LANES].reshape((blocks, LANES))
    ranks = rank[: blocks * LANES].reshape((blocks, LANES))
    for one in range(blocks):
        for other in range(blocks):
            _count_less(keys[one], keys[other], ranks[one], other == 0)
    chosen[:] = -1
    for i in range(m):
        place = rank[i]
        while place < k and chosen[place] >= 0:
            place += 1
        if place < k:
            chosen[place] = i
