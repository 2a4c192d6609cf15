"""Neighbour graph: which dots lie next to each other on the lattice, found from positions and shapes alone.

The footprints of the dots are round in the projector, so their shape in the image tells the local affine map of the
lattice too: in the metric of the footprints the lattice is (nearly) regular however oblique the view. There, each dot
searches the basis (a, b) of its surroundings; links that both ends agree on are followed to connected components with
integer lattice coordinates (paper, section III.B: nearest neighbours, then diagonals from the prediction, then
consistency).

Directions are numbered counter to nothing but the image axes: from x towards y. The same order holds in the projector,
so that a mirrored pattern never matches.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sl_decoder.compiled import compiled

NEIGHBOURS = 16  # candidates looked at around each dot
BLUR = 0.3  # variance that the image's filter and the optics add to a footprint's core [px^2]
BLUR_MOST = 0.6  # but no more than this share of its narrow side
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


@compiled
def smooth_shapes(covariance, near, blur_most):
    """Mean footprint (N, 3) over each dot and its eight nearest, each without blur and normalised to unit area first.

    Blur makes a footprint rounder than the lattice's metric is, the more the smaller the dot and the more oblique the
    view. blur_most: variance to take off [px^2].
    """
    n = len(covariance)
    out = np.empty((n, 3), np.float32)
    sharp = np.empty((n, 3), np.float32)
    for i in range(n):
        a, b, c = covariance[i, 0], covariance[i, 1], covariance[i, 2]
        difference = np.float32(0.5) * (a - c)
        narrow = np.float32(0.5) * (a + c) - np.sqrt(difference * difference + b * b)
        blur = min(np.float32(blur_most), np.float32(BLUR_MOST) * max(narrow, np.float32(0)))
        a -= blur
        c -= blur
        s = 1.0 / np.sqrt(max(a * c - b * b, 1e-3))
        sharp[i, 0] = a * s
        sharp[i, 1] = b * s
        sharp[i, 2] = c * s
    for i in range(n):
        a = b = c = 0.0
        for m in range(-1, 8):
            j = i if m < 0 else near[i, m]
            if j < 0:
                break
            a += sharp[j, 0]
            b += sharp[j, 1]
            c += sharp[j, 2]
        s = 1.0 / np.sqrt(max(a * c - b * b, 1e-6))
        out[i, 0] = a * s
        out[i, 1] = b * s
        out[i, 2] = c * s
    return out


@compiled
def local_bases(points, shape, near, directions, tolerance, links, quality):
    """Lattice neighbours of every dot: links (N, D) int32, quality (N,) float32 (sum of squared errors, inf none)."""
    n, k = near.shape
    dx = np.empty(k, np.float32)
    dy = np.empty(k, np.float32)
    rr = np.empty(k, np.float32)
    order = np.empty(k, np.int32)
    chosen = np.empty(6, np.int32)
    cosine_ideal = np.float32(np.cos(2.0 * np.pi / directions))
    sine_ideal = np.float32(np.sin(2.0 * np.pi / directions))
    for i in range(n):
        for d in range(directions):
            links[i, d] = -1
        quality[i] = np.inf
        # whitening by the inverse square root of the shape (unit determinant): (S^-1 + I) / sqrt(tr S + 2)
        a, b, c = shape[i, 0], shape[i, 1], shape[i, 2]
        t = np.float32(1) / np.sqrt(a + c + np.float32(2))
        wxx, wxy, wyy = (c + 1) * t, -b * t, (a + 1) * t
        m = 0
        px, py = points[i, 0], points[i, 1]
        for q in range(k):
            j = near[i, q]
            if j < 0:
                break
            ex = points[j, 0] - px
            ey = points[j, 1] - py
            fx = wxx * ex + wxy * ey
            fy = wxy * ex + wyy * ey
            r = fx * fx + fy * fy
            p = m
            while p > 0 and rr[p - 1] > r:
                rr[p], dx[p], dy[p], order[p] = rr[p - 1], dx[p - 1], dy[p - 1], order[p - 1]
                p -= 1
            rr[p], dx[p], dy[p], order[p] = r, fx, fy, j
            m += 1
        best = np.float32(np.inf)
        done = False
        for ia in range(min(m, 4)):
            if done or rr[ia] > 4 * rr[0]:
                break
            ax, ay = dx[ia], dy[ia]
            la2 = rr[ia]
            tried = 0
            for ib in range(m):
                if ib == ia:
                    continue
                lb2 = rr[ib]
                if lb2 > np.float32(4.84) * la2:
                    break
                cross = ax * dy[ib] - ay * dx[ib]
                if cross <= 0:
                    continue
                dot = ax * dx[ib] + ay * dy[ib]
                # within 35 degrees of the ideal angle: cosine of the difference
                cosine = (cosine_ideal * dot + sine_ideal * cross) / np.sqrt(la2 * lb2)
                if cosine < np.float32(0.814):
                    continue
                tried += 1
                if tried > 3:
                    break
                bx, by = dx[ib], dy[ib]
                limit2 = tolerance * tolerance * min(la2, lb2)
                missing = 0
                error = np.float32(0)
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
                    elif d == 2:
                        ex, ey = bx - ax, by - ay
                    elif d == 3:
                        ex, ey = -ax, -ay
                    elif d == 4:
                        ex, ey = -bx, -by
                    else:
                        ex, ey = ax - bx, ay - by
                    e = limit2
                    to = -1
                    for j in range(m):
                        fx = dx[j] - ex
                        fy = dy[j] - ey
                        r = fx * fx + fy * fy
                        if r < e:
                            e = r
                            to = j
                    chosen[d] = to
                    error += e
                    if to < 0:
                        missing += 1
                if missing > directions // 2 - 1:
                    continue
                # small cells, small errors, round cells first
                score = (la2 + lb2) / rr[0] * (1 + error / limit2) * (1 + 2 * (1 - cosine)) + 4 * missing
                if score < best:
                    best = score
                    quality[i] = score
                    for d in range(directions):
                        links[i, d] = -1 if chosen[d] < 0 else order[chosen[d]]
                if (
                    missing == 0
                    and ia == 0
                    and lb2 < 2 * la2
                    and error < np.float32(0.5) * limit2
                    and cosine > np.float32(0.95)
                ):
                    done = True
                    break


@compiled
def components(links, quality, steps, component, frame, u, v):
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
