"""Growth over the map: dots next to decoded ones are predicted, looked for, verified; outliers are cut out again.

Works on the map's own lattice: claim[v, u] is the dot that holds an element of the map. A free element next to held ones is
predicted from them (interpolation between opposite neighbours, parallelograms, continued lines); the nearest free dot is
taken when it fits in position and letter. Then every held dot is judged by its letter, by its distance from the position
that its neighbours predict, and by its neighbours' fate (mean field); what fails is released, undecoded.
"""

from __future__ import annotations

import numpy as np
from numba import njit

REACH = 0.35  # a dot is looked for this far from its prediction, in lattice units
COUPLING = 0.7
SWEEPS = 5


@njit(cache=True, boundscheck=False, inline="always")
def _inside(v, u, rows, cols):  # type: ignore[no-untyped-def]
    return 0 <= v < rows and 0 <= u < cols


@njit(cache=True, boundscheck=False)
def predict(claim, centre, v, u, steps):  # type: ignore[no-untyped-def]
    """Position of map element (u, v) from its held neighbours.

    Returns x, y, weight (0: no prediction), ax, ay, bx, by: the local lattice basis [px] (zero where unknown).
    """
    rows, cols = claim.shape
    directions = len(steps)
    half = directions // 2
    sx = sy = sw = 0.0
    ax = ay = bx = by = 0.0
    na = 0
    nb = 0
    for d in range(directions):
        v1, u1 = v + steps[d, 1], u + steps[d, 0]
        if not _inside(v1, u1, rows, cols) or claim[v1, u1] < 0:
            continue
        p = claim[v1, u1]
        # opposite neighbour: interpolation
        if d < half:
            v2, u2 = v - steps[d, 1], u - steps[d, 0]
            if _inside(v2, u2, rows, cols) and claim[v2, u2] >= 0:
                q = claim[v2, u2]
                sx += 2.0 * (centre[p, 0] + centre[q, 0])
                sy += 2.0 * (centre[p, 1] + centre[q, 1])
                sw += 4.0
        # the line through two beyond
        v2, u2 = v1 + steps[d, 1], u1 + steps[d, 0]
        if _inside(v2, u2, rows, cols) and claim[v2, u2] >= 0:
            q = claim[v2, u2]
            lx, ly = centre[q, 0] - centre[p, 0], centre[q, 1] - centre[p, 1]
            v3, u3 = v2 + steps[d, 1], u2 + steps[d, 0]
            if _inside(v3, u3, rows, cols) and claim[v3, u3] >= 0:
                # quadratic continuation
                r = claim[v3, u3]
                sx += 0.5 * (3.0 * centre[p, 0] - 3.0 * centre[q, 0] + centre[r, 0])
                sy += 0.5 * (3.0 * centre[p, 1] - 3.0 * centre[q, 1] + centre[r, 1])
                sw += 0.5
            sx += 0.5 * (centre[p, 0] - lx)
            sy += 0.5 * (centre[p, 1] - ly)
            sw += 0.5
            s = 1.0 if d < half else -1.0
            if d % half == 0:
                ax += s * lx
                ay += s * ly
                na += 1
            elif d % half == 1:
                bx += s * lx
                by += s * ly
                nb += 1
        # parallelogram with the next direction (square) or the rhombus of the hexagonal grid
        e = (d + 1) % directions
        vb, ub = v + steps[e, 1], u + steps[e, 0]
        vc, uc = v1 + steps[e, 1], u1 + steps[e, 0]
        if _inside(vb, ub, rows, cols) and claim[vb, ub] >= 0 and _inside(vc, uc, rows, cols) and claim[vc, uc] >= 0:
            q, r = claim[vb, ub], claim[vc, uc]
            sx += centre[p, 0] + centre[q, 0] - centre[r, 0]
            sy += centre[p, 1] + centre[q, 1] - centre[r, 1]
            sw += 1.0
        # sides parallel to the basis
        if _inside(vc, uc, rows, cols) and claim[vc, uc] >= 0:
            r = claim[vc, uc]
            lx, ly = centre[r, 0] - centre[p, 0], centre[r, 1] - centre[p, 1]
            s = 1.0 if e < half else -1.0
            if e % half == 0:
                ax += s * lx
                ay += s * ly
                na += 1
            elif e % half == 1:
                bx += s * lx
                by += s * ly
                nb += 1
        f = (d + directions - 1) % directions
        vc, uc = v1 + steps[f, 1], u1 + steps[f, 0]
        if _inside(vc, uc, rows, cols) and claim[vc, uc] >= 0:
            r = claim[vc, uc]
            lx, ly = centre[r, 0] - centre[p, 0], centre[r, 1] - centre[p, 1]
            s = 1.0 if f < half else -1.0
            if f % half == 0:
                ax += s * lx
                ay += s * ly
                na += 1
            elif f % half == 1:
                bx += s * lx
                by += s * ly
                nb += 1
    if sw == 0.0 or na == 0 or nb == 0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    return sx / sw, sy / sw, sw, ax / na, ay / na, bx / nb, by / nb


@njit(cache=True, boundscheck=False)
def lattice_error(ex, ey, ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """Length of an image vector in units of the lattice basis (a, b), inf for a degenerate basis."""
    det = ax * by - ay * bx
    if det <= 1e-3:
        return np.inf
    s = (ex * by - ey * bx) / det
    t = (ax * ey - ay * ex) / det
    return np.sqrt(s * s + t * t)


@njit(cache=True, boundscheck=False)
def grow(claim, holder_v, holder_u, centre, near, log_p, map_letters, steps, reach, least):  # type: ignore[no-untyped-def]
    """Claim free dots around the held ones until nothing fits any more; returns how many were added."""
    rows, cols = claim.shape
    directions = len(steps)
    log_a = np.log(float(log_p.shape[1]))
    queue_v = np.empty(rows * cols * 4, np.int32)
    queue_u = np.empty(rows * cols * 4, np.int32)
    tail = 0
    for v in range(rows):
        for u in range(cols):
            if claim[v, u] < 0:
                continue
            for d in range(directions):
                vv, uu = v + steps[d, 1], u + steps[d, 0]
                if _inside(vv, uu, rows, cols) and claim[vv, uu] < 0 and map_letters[vv, uu] >= 0 and tail < len(queue_v):
                    queue_v[tail] = vv
                    queue_u[tail] = uu
                    tail += 1
    head = 0
    added = 0
    while head < tail:
        v, u = queue_v[head], queue_u[head]
        head += 1
        if claim[v, u] >= 0:
            continue
        x, y, w, ax, ay, bx, by = predict(claim, centre, v, u, steps)
        if w == 0.0:
            continue
        best = reach
        to = -1
        for d in range(directions):
            vv, uu = v + steps[d, 1], u + steps[d, 0]
            if not _inside(vv, uu, rows, cols) or claim[vv, uu] < 0:
                continue
            p = claim[vv, uu]
            for m in range(near.shape[1]):
                j = near[p, m]
                if j < 0:
                    break
                if holder_v[j] >= 0:
                    continue
                e = lattice_error(centre[j, 0] - x, centre[j, 1] - y, ax, ay, bx, by)
                # a fitting letter outweighs a little distance
                e -= 0.05 * max(-2.0, log_p[j, map_letters[v, u]] + log_a)
                if e < best:
                    best = e
                    to = j
        if to < 0:
            continue
        if log_p[to, map_letters[v, u]] + log_a < least and w < 6.0:
            continue
        claim[v, u] = to
        holder_v[to] = v
        holder_u[to] = u
        added += 1
        for d in range(directions):
            vv, uu = v + steps[d, 1], u + steps[d, 0]
            if _inside(vv, uu, rows, cols) and claim[vv, uu] < 0 and map_letters[vv, uu] >= 0 and tail < len(queue_v):
                queue_v[tail] = vv
                queue_u[tail] = uu
                tail += 1
    return added


@njit(cache=True, boundscheck=False)
def judge(claim, centre, log_p, map_letters, steps, window, sigma, coupling, sweeps, belief, own, residual):  # type: ignore[no-untyped-def]
    """Log-odds (V, U) that each held dot is right: letter, position residual [lattice units], neighbours."""
    rows, cols = claim.shape
    log_a = np.log(float(log_p.shape[1]))
    q = np.zeros((rows, cols), np.float32)
    for v in range(rows):
        for u in range(cols):
            i = claim[v, u]
            belief[v, u] = -20.0
            residual[v, u] = np.nan
            if i < 0:
                continue
            x, y, w, ax, ay, bx, by = predict(claim, centre, v, u, steps)
            letter = log_p[i, map_letters[v, u]] + log_a
            if w > 0.0:
                e = lattice_error(centre[i, 0] - x, centre[i, 1] - y, ax, ay, bx, by)
                residual[v, u] = e
                # the prediction itself is less certain where it extrapolates
                s = sigma * (1.0 if w >= 4.0 else 2.0)
                fit = np.exp(-0.5 * (e / s) ** 2) * 0.97 + 0.03 * np.exp(-e / 0.2)
                position = max(-4.0, min(3.0, np.log(fit / (2.0 * np.pi * s * s) + 1e-6)))
            else:
                position = -1.0
            own[v, u] = letter + position
            q[v, u] = np.tanh(0.5 * max(-4.0, min(4.0, own[v, u])))
    for _ in range(sweeps):
        for v in range(rows):
            for u in range(cols):
                if claim[v, u] < 0:
                    continue
                total = 0.0
                for p in range(1, len(window)):
                    vv, uu = v + window[p, 1], u + window[p, 0]
                    if _inside(vv, uu, rows, cols) and claim[vv, uu] >= 0:
                        total += q[vv, uu]
                belief[v, u] = own[v, u] + coupling * total
                q[v, u] = np.tanh(0.5 * belief[v, u])
