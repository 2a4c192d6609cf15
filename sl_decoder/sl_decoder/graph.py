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

NEIGHBOURS = 12  # nearest dots looked at around each: the eight around it on its lattice, and the four beyond
RING = 8  # nearest dots whose footprints tell the metric around a dot
BLUR = 0.3  # variance that the image's filter and the optics add to a footprint's core [px^2]
BLUR_MOST = 0.6  # but no more than this share of its narrow side
TOLERANCE = 0.30  # a neighbour lies this close to its prediction, in units of the local lattice spacing
WIDEST = 0.814  # cosine of the angle (35 degrees) by which a basis may differ from the ideal one
LONGEST = 2.2  # times the length of its first vector that the second of a basis may have
BEYOND = np.float32(1e9)  # where no candidate is
NOBODY = np.int32(0x7FFFFFFF)  # a key beyond those of all candidates
ROOM = 16  # for the candidates of a dot: loops of a power of two are vector code throughout
LAST = np.int32(ROOM - 1)  # bits of a key that number the candidate


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
    one, half = np.float32(1), np.float32(0.5)
    out = np.empty((n, 3), np.float32)
    sharp = np.zeros((n + 1, 3), np.float32)  # the last is what the index -1 means: no neighbour
    for i in range(n):
        a, b, c = covariance[i, 0], covariance[i, 1], covariance[i, 2]
        difference = half * (a - c)
        narrow = half * (a + c) - np.sqrt(difference * difference + b * b)
        blur = min(np.float32(blur_most), np.float32(BLUR_MOST) * max(narrow, np.float32(0)))
        a -= blur
        c -= blur
        s = one / np.sqrt(max(a * c - b * b, np.float32(1e-3)))
        sharp[i, 0], sharp[i, 1], sharp[i, 2] = a * s, b * s, c * s
    for i in range(n):
        a, b, c = sharp[i, 0], sharp[i, 1], sharp[i, 2]
        for q in range(min(near.shape[1], RING)):
            j = near[i, q]
            a += sharp[j, 0]
            b += sharp[j, 1]
            c += sharp[j, 2]
        s = one / np.sqrt(max(a * c - b * b, np.float32(1e-6)))
        out[i, 0], out[i, 1], out[i, 2] = a * s, b * s, c * s
    return out


@compiled
def local_bases(points, shape, near, directions, tolerance, links, quality):
    """Lattice neighbours of every dot: links (N, D) int32, quality (N,) float32 (sum of squared errors, inf none).

    near (N, NEIGHBOURS) int32 or -1. Vectors to the candidates are taken in the metric of the footprints, and looked up
    by keys: the squared length (positive floats keep their order as integers) with the candidate in the lowest bits.
    """
    n = len(near)
    k = min(near.shape[1], NEIGHBOURS)
    dx = np.full(ROOM, BEYOND)
    dy = np.full(ROOM, BEYOND)
    length = np.full(ROOM, NOBODY)
    beside = np.full(ROOM, NOBODY)
    chosen = np.empty(6, np.int32)
    cosine_ideal = np.float32(np.cos(2.0 * np.pi / directions))
    sine_ideal = np.float32(np.sin(2.0 * np.pi / directions))
    for i in range(n):
        links[i] = -1
        quality[i] = np.inf
        # whitening by the inverse square root of the shape (unit determinant): (S^-1 + I) / sqrt(tr S + 2)
        a, b, c = shape[i, 0], shape[i, 1], shape[i, 2]
        t = np.float32(1) / np.sqrt(a + c + np.float32(2))
        wxx, wxy, wyy = (c + np.float32(1)) * t, -b * t, (a + np.float32(1)) * t
        px, py = points[i, 0], points[i, 1]
        for q in range(k):
            j = max(near[i, q], 0)
            ex, ey = points[j, 0] - px, points[j, 1] - py
            dx[q] = wxx * ex + wxy * ey if near[i, q] >= 0 else BEYOND
            dy[q] = wxy * ex + wyy * ey
            length[q] = _key(dx[q] * dx[q] + dy[q] * dy[q], q)
        best = shortest = np.float32(np.inf)
        first = np.int32(-1)
        done = False
        for turn in range(4):
            if done:
                break
            first = _next(length, first)
            ia = first & LAST
            ax, ay = dx[ia], dy[ia]
            la2 = ax * ax + ay * ay
            shortest = min(shortest, la2)
            if la2 > np.float32(4) * shortest or la2 >= BEYOND:
                break
            for q in range(min(len(dx), ROOM)):
                cross = ax * dy[q] - ay * dx[q]
                toward = cosine_ideal * (ax * dx[q] + ay * dy[q]) + sine_ideal * cross
                lb2 = dx[q] * dx[q] + dy[q] * dy[q]
                fits = (cross > 0) & (toward > 0) & (toward * toward >= np.float32(WIDEST * WIDEST) * la2 * lb2)
                beside[q] = length[q] if fits & (lb2 <= np.float32(LONGEST * LONGEST) * la2) else NOBODY
            second = np.int32(-1)
            for _ in range(3):
                second = _next(beside, second)
                if second == NOBODY:
                    break
                ib = second & LAST
                bx, by = dx[ib], dy[ib]
                lb2 = bx * bx + by * by
                limit2 = np.float32(tolerance * tolerance) * min(la2, lb2)
                chosen[0], chosen[1] = ia, ib
                missing = 0
                error = np.float32(0)
                for d in range(2, directions):
                    if directions == 4:
                        ex, ey = (-ax, -ay) if d == 2 else (-bx, -by)
                    elif d == 2:
                        ex, ey = bx - ax, by - ay
                    elif d == 3:
                        ex, ey = -ax, -ay
                    elif d == 4:
                        ex, ey = -bx, -by
                    else:
                        ex, ey = ax - bx, ay - by
                    to = _closest(dx, dy, ex, ey)
                    fx, fy = dx[to] - ex, dy[to] - ey
                    e = fx * fx + fy * fy
                    chosen[d] = to if e < limit2 else -1
                    error += min(e, limit2)
                    missing += e >= limit2
                if missing > directions // 2 - 1:
                    continue
                # small cells, small errors, round cells first
                cosine = (cosine_ideal * (ax * bx + ay * by) + sine_ideal * (ax * by - ay * bx)) / np.sqrt(la2 * lb2)
                score = (la2 + lb2) / shortest * (1 + error / limit2) * (1 + 2 * (1 - cosine)) + 4 * missing
                if score < best:
                    best = score
                    quality[i] = score
                    for d in range(directions):
                        links[i, d] = -1 if chosen[d] < 0 else near[i, chosen[d]]
                good = cosine > np.float32(0.95) and error < np.float32(0.5) * limit2
                if good and missing == 0 and turn == 0 and lb2 < 2 * la2:
                    done = True
                    break


@compiled
def _key(squared, q):
    """Key (int32) of candidate q at a squared distance (float32)."""
    return np.int32((np.float32(squared).view(np.int32) & ~LAST) | q)


@compiled
def _next(keys, before):
    """Least of keys (ROOM,) int32 above `before`, or NOBODY: one after the other, they come in order."""
    after = before + np.int32(1)
    least = np.uint32(NOBODY - after)
    for q in range(min(len(keys), ROOM)):
        ahead = np.uint32(keys[q] - after)  # huge for those that have been
        least = ahead if ahead < least else least
    return np.int32(least + after)


@compiled
def _closest(dx, dy, x, y):
    """Which of the vectors (dx, dy), (ROOM,) float32 each, is closest to (x, y)."""
    least = NOBODY
    for q in range(min(len(dx), ROOM)):
        key = _key((dx[q] - x) * (dx[q] - x) + (dy[q] - y) * (dy[q] - y), q)
        least = key if key < least else least
    return least & LAST


@compiled
def components(links, quality, steps, component, frame, u, v):
    """Follow links from the best dots on; returns the number of components, and which dots are in conflict (N,) bool.

    A link is followed where both ends agree (or where the far end has no basis of its own); a dot that is reached
    with two different coordinates is left out of the graph.
    """
    n = len(links)
    component[:] = -1
    conflicts = np.zeros(n, np.bool_)
    queue = np.empty(n, np.int32)
    if n == 0:
        return 0, conflicts
    # what the best dot of all is not connected with is mostly little: only that is sorted
    _follow(np.argmin(quality), 0, links, quality, steps, component, frame, u, v, conflicts, queue)
    rest = np.flatnonzero((component < 0) & (quality < np.inf))
    count = 1
    for seed in rest[np.argsort(quality[rest])]:
        if component[seed] < 0:
            _follow(seed, count, links, quality, steps, component, frame, u, v, conflicts, queue)
            count += 1
    return count, conflicts


@compiled
def _follow(seed, number, links, quality, steps, component, frame, u, v, conflicts, queue):
    """Give the dots that are connected with `seed` the component `number`."""
    directions = links.shape[1]
    half = directions // 2
    component[seed] = number
    frame[seed] = u[seed] = v[seed] = 0
    head, tail = 0, 1
    queue[0] = seed
    while head < tail:
        i = queue[head]
        head += 1
        if quality[i] == np.inf:
            continue
        for d in range(directions):
            j = links[i, d]
            if j < 0:
                continue
            world = d + frame[i]
            world -= directions if world >= directions else 0
            f = -1
            if quality[j] < np.inf:
                back = -1
                for e in range(directions):
                    back = e if links[j, e] == i else back
                if back < 0:
                    continue
                f = world + half - back
                f += directions if f < 0 else 0
                f -= directions if f >= directions else 0
            nu = u[i] + steps[world, 0]
            nv = v[i] + steps[world, 1]
            if component[j] < 0:
                component[j] = number
                frame[j] = max(f, 0)
                u[j] = nu
                v[j] = nv
                queue[tail] = j
                tail += 1
            elif component[j] == number and (u[j] != nu or v[j] != nv or (f >= 0 and frame[j] != f)):
                conflicts[j] = True
