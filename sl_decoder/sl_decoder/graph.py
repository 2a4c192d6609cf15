"""Neighbour graph: which dots lie next to each other on the lattice, found from positions and shapes alone.

The footprints of the dots are round in the projector, so their shape in the image tells the local affine map of the lattice
too: in the metric of the footprints the lattice is (nearly) regular however oblique the view. There, each dot searches the
basis (a, b) of its surroundings; links that both ends agree on are followed to connected components with integer lattice
coordinates (paper, section III.B: nearest neighbours, then diagonals from the prediction, then consistency).

Directions are numbered counter to nothing but the image axes: from x towards y. The same order holds in the projector,
so that a mirrored pattern never matches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

NEIGHBOURS = 16  # candidates looked at around each dot
TOLERANCE = 0.30  # a neighbour lies this close to its prediction, in units of the local lattice spacing


@dataclass(frozen=True)
class Graph:
    """links (N, D) int32: neighbour in each lattice direction or -1; frame (N,) int32 the direction of the component
    that a dot's direction 0 is; component (N,) int32 or -1; u, v (N,) int32 lattice coordinates in the component."""

    links: np.ndarray
    component: np.ndarray
    frame: np.ndarray
    u: np.ndarray
    v: np.ndarray
    count: int


@njit(cache=True, boundscheck=False)
def nearest(points, k):  # type: ignore[no-untyped-def]
    """Indices (N, k) int32 of the k nearest other points of points (N, 2), by distance, -1 where there are fewer."""
    n = len(points)
    out = np.full((n, k), -1, np.int32)
    if n < 2:
        return out
    x0, y0 = points[0, 0], points[0, 1]
    x1, y1 = x0, y0
    for i in range(n):
        x0 = min(x0, points[i, 0])
        x1 = max(x1, points[i, 0])
        y0 = min(y0, points[i, 1])
        y1 = max(y1, points[i, 1])
    cell = max(np.sqrt((x1 - x0 + 1.0) * (y1 - y0 + 1.0) * 4.0 / n), 1.0)
    nx = int((x1 - x0) / cell) + 1
    ny = int((y1 - y0) / cell) + 1
    head = np.zeros(nx * ny + 1, np.int32)
    where = np.empty(n, np.int32)
    for i in range(n):
        c = int((points[i, 1] - y0) / cell) * nx + int((points[i, 0] - x0) / cell)
        where[i] = c
        head[c + 1] += 1
    for c in range(nx * ny):
        head[c + 1] += head[c]
    fill = head[:-1].copy()
    members = np.empty(n, np.int32)
    for i in range(n):
        members[fill[where[i]]] = i
        fill[where[i]] += 1
    best = np.empty(k, np.float32)
    for i in range(n):
        px, py = points[i, 0], points[i, 1]
        cx = int((px - x0) / cell)
        cy = int((py - y0) / cell)
        found = 0
        ring = 0
        while ring <= max(nx, ny):
            if found == k:
                # nothing in this ring can be nearer than the distance to the border of what was searched
                gap = min(min(px - x0 - (cx - ring + 1) * cell, x0 + (cx + ring) * cell - px),
                          min(py - y0 - (cy - ring + 1) * cell, y0 + (cy + ring) * cell - py))
                if gap * gap > best[k - 1]:
                    break
            for gy in range(max(0, cy - ring), min(ny, cy + ring + 1)):
                edge = gy == cy - ring or gy == cy + ring
                step = 1 if edge or ring == 0 else 2 * ring
                gx = cx - ring
                while gx <= cx + ring:
                    if 0 <= gx < nx:
                        c = gy * nx + gx
                        for m in range(head[c], head[c + 1]):
                            j = members[m]
                            if j == i:
                                continue
                            d = (points[j, 0] - px) ** 2 + (points[j, 1] - py) ** 2
                            if found < k:
                                p = found
                                found += 1
                            elif d < best[k - 1]:
                                p = k - 1
                            else:
                                continue
                            while p > 0 and best[p - 1] > d:
                                best[p] = best[p - 1]
                                out[i, p] = out[i, p - 1]
                                p -= 1
                            best[p] = d
                            out[i, p] = j
                    gx += step
            ring += 1
    return out


@njit(cache=True, boundscheck=False)
def smooth_shapes(covariance, near):  # type: ignore[no-untyped-def]
    """Mean footprint (N, 3) over each dot and its eight nearest, each normalised to unit area first."""
    n = len(covariance)
    out = np.empty((n, 3), np.float32)
    for i in range(n):
        a = b = c = 0.0
        for m in range(-1, 8):
            j = i if m < 0 else near[i, m]
            if j < 0:
                break
            det = covariance[j, 0] * covariance[j, 2] - covariance[j, 1] ** 2
            s = 1.0 / np.sqrt(max(det, 1e-3))
            a += covariance[j, 0] * s
            b += covariance[j, 1] * s
            c += covariance[j, 2] * s
        s = 1.0 / np.sqrt(max(a * c - b * b, 1e-6))
        out[i, 0] = a * s
        out[i, 1] = b * s
        out[i, 2] = c * s
    return out


@njit(cache=True, boundscheck=False)
def _closest(ex, ey, dx, dy, m, limit, skip):  # type: ignore[no-untyped-def]
    best = limit * limit
    to = -1
    for j in range(m):
        if j == skip:
            continue
        d = (dx[j] - ex) ** 2 + (dy[j] - ey) ** 2
        if d < best:
            best = d
            to = j
    return to, best


@njit(cache=True, boundscheck=False)
def local_bases(points, shape, near, directions, tolerance, links, quality):  # type: ignore[no-untyped-def]
    """Lattice neighbours of every dot: links (N, D) int32, quality (N,) float32 (sum of squared errors, inf none)."""
    n, k = near.shape
    dx = np.empty(k, np.float32)
    dy = np.empty(k, np.float32)
    rr = np.empty(k, np.float32)
    order = np.empty(k, np.int32)
    chosen = np.empty(6, np.int32)
    ideal = 2.0 * np.pi / directions
    for i in range(n):
        for d in range(directions):
            links[i, d] = -1
        quality[i] = np.inf
        # whitening by the inverse square root of the shape (unit determinant): (S + I) / sqrt(tr S + 2)
        a, b, c = shape[i, 0], shape[i, 1], shape[i, 2]
        t = np.sqrt(a + c + 2.0)
        wxx, wxy, wyy = (c + 1.0) / t, -b / t, (a + 1.0) / t
        m = 0
        for q in range(k):
            j = near[i, q]
            if j < 0:
                break
            ex = points[j, 0] - points[i, 0]
            ey = points[j, 1] - points[i, 1]
            fx = wxx * ex + wxy * ey
            fy = wxy * ex + wyy * ey
            r = fx * fx + fy * fy
            p = m
            while p > 0 and rr[p - 1] > r:
                rr[p], dx[p], dy[p], order[p] = rr[p - 1], dx[p - 1], dy[p - 1], order[p - 1]
                p -= 1
            rr[p], dx[p], dy[p], order[p] = r, fx, fy, j
            m += 1
        best = np.inf
        for ia in range(min(m, 4)):
            ax, ay = dx[ia], dy[ia]
            la = np.sqrt(rr[ia])
            if la * la > 4.0 * rr[0]:
                break
            tried = 0
            for ib in range(m):
                if ib == ia:
                    continue
                lb = np.sqrt(rr[ib])
                if lb > 2.2 * la:
                    break
                cross = ax * dy[ib] - ay * dx[ib]
                dot = ax * dx[ib] + ay * dy[ib]
                angle = np.arctan2(cross, dot)
                if abs(angle - ideal) > 0.62:
                    continue
                tried += 1
                if tried > 3:
                    break
                bx, by = dx[ib], dy[ib]
                limit = tolerance * min(la, lb)
                missing = 0
                error = 0.0
                for d in range(directions):
                    if d == 0:
                        chosen[0] = ia
                        continue
                    if d == 1:
                        chosen[1] = ib
                        continue
                    if directions == 4:
                        ex = -ax if d == 2 else -bx
                        ey = -ay if d == 2 else -by
                    else:
                        if d == 2:
                            ex, ey = bx - ax, by - ay
                        elif d == 3:
                            ex, ey = -ax, -ay
                        elif d == 4:
                            ex, ey = -bx, -by
                        else:
                            ex, ey = ax - bx, ay - by
                    to, e = _closest(ex, ey, dx, dy, m, limit, -1)
                    chosen[d] = to
                    if to < 0:
                        missing += 1
                        error += limit * limit
                    else:
                        error += e
                if missing > (1 if directions == 4 else 2):
                    continue
                # small cells, small errors, round cells first
                score = (la * la + lb * lb) / rr[0] * (1.0 + error / (limit * limit)) * (1.0 + (angle - ideal) ** 2) + 4.0 * missing
                if score < best:
                    best = score
                    quality[i] = score
                    for d in range(directions):
                        links[i, d] = -1 if chosen[d] < 0 else order[chosen[d]]


@njit(cache=True, boundscheck=False)
def components(links, quality, steps, component, frame, u, v):  # type: ignore[no-untyped-def]
    """Follow links from the best dots on; returns the number of components.

    A link is followed where both ends agree (or where the far end has no basis of its own); a dot that is reached
    with two different coordinates is left out of the graph.
    """
    n, directions = links.shape
    half = directions // 2
    for i in range(n):
        component[i] = -1
    conflicts = np.zeros(n, np.bool_)
    queue = np.empty(n, np.int32)
    start = np.argsort(quality)
    count = 0
    for s in range(n):
        seed = start[s]
        if component[seed] >= 0 or not np.isfinite(quality[seed]):
            continue
        component[seed] = count
        frame[seed] = 0
        u[seed] = 0
        v[seed] = 0
        head, tail = 0, 1
        queue[0] = seed
        while head < tail:
            i = queue[head]
            head += 1
            if not np.isfinite(quality[i]):
                continue
            for d in range(directions):
                j = links[i, d]
                if j < 0:
                    continue
                world = (d + frame[i]) % directions
                if np.isfinite(quality[j]):
                    back = -1
                    for e in range(directions):
                        if links[j, e] == i:
                            back = e
                    if back < 0:
                        continue
                    f = (world + half - back) % directions
                else:
                    f = -1
                nu = u[i] + steps[world, 0]
                nv = v[i] + steps[world, 1]
                if component[j] < 0:
                    component[j] = count
                    frame[j] = f if f >= 0 else 0
                    u[j] = nu
                    v[j] = nv
                    queue[tail] = j
                    tail += 1
                elif component[j] == count and (u[j] != nu or v[j] != nv or (f >= 0 and frame[j] != f)):
                    conflicts[j] = True
        count += 1
    return count, conflicts
