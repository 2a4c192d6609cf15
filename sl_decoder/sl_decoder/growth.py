"""Growth over the map: dots next to decoded ones are predicted, looked for and claimed.

Works on the map's own lattice: claim[v, u] is the dot that holds an element of the map, -1 none. A free element next
to held ones is predicted from them; the nearest free dot is claimed when it fits in place and letter. What was
claimed is judged afterwards (judgement.py), together with its neighbours.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.compiled import compiled

REACH = 0.35  # a dot is looked for this far from its prediction, in lattice units
LETTER_WEIGHT = 0.05  # lattice units that a fitting letter is worth (per log-odds) when two dots compete

FULL, INTERPOLATED, EXTRAPOLATED, UNPREDICTED = 0, 1, 2, 3


@compiled
def predict(claim, centre, v, u, steps):
    """Position of map element (u, v) from the held elements around it.

    With its whole ring: the biharmonic mean, exact on cubic surfaces. Else the mean of what there is: parallelograms at
    its corners, midpoints of opposite neighbours, lines continued (quadratically from three points, linearly from two).
    Returns x, y [px], kind (FULL, INTERPOLATED, EXTRAPOLATED, UNPREDICTED), and the local basis ax, ay, bx, by [px].
    """
    rows, cols = claim.shape
    directions = len(steps)
    if directions == 4 and 0 < v < rows - 1 and 0 < u < cols - 1:
        # the common case, a whole ring on the square grid, without detours
        i0, i1, i2 = claim[v - 1, u - 1], claim[v - 1, u], claim[v - 1, u + 1]
        i3, i5 = claim[v, u - 1], claim[v, u + 1]
        i6, i7, i8 = claim[v + 1, u - 1], claim[v + 1, u], claim[v + 1, u + 1]
        if min(min(min(i0, i1), min(i2, i3)), min(min(i5, i6), min(i7, i8))) >= 0:
            h, q = np.float32(0.5), np.float32(0.25)
            s6 = np.float32(1 / 6)
            x = h * (centre[i1, 0] + centre[i3, 0] + centre[i5, 0] + centre[i7, 0]) - q * (
                centre[i0, 0] + centre[i2, 0] + centre[i6, 0] + centre[i8, 0]
            )
            y = h * (centre[i1, 1] + centre[i3, 1] + centre[i5, 1] + centre[i7, 1]) - q * (
                centre[i0, 1] + centre[i2, 1] + centre[i6, 1] + centre[i8, 1]
            )
            fax = s6 * (centre[i2, 0] - centre[i0, 0] + centre[i5, 0] - centre[i3, 0] + centre[i8, 0] - centre[i6, 0])
            fay = s6 * (centre[i2, 1] - centre[i0, 1] + centre[i5, 1] - centre[i3, 1] + centre[i8, 1] - centre[i6, 1])
            fbx = s6 * (centre[i6, 0] - centre[i0, 0] + centre[i7, 0] - centre[i1, 0] + centre[i8, 0] - centre[i2, 0])
            fby = s6 * (centre[i6, 1] - centre[i0, 1] + centre[i7, 1] - centre[i1, 1] + centre[i8, 1] - centre[i2, 1])
            return x, y, FULL, fax, fay, fbx, fby
    half = directions // 2
    hx = np.empty(6, np.float32)
    hy = np.empty(6, np.float32)
    held = np.zeros(6, np.bool_)
    dx = np.empty(6, np.float32)
    dy = np.empty(6, np.float32)
    diagonal = np.zeros(6, np.bool_)
    n_held = 0
    n_diagonal = 0
    for d in range(directions):
        v1, u1 = v + steps[d, 1], u + steps[d, 0]
        if 0 <= v1 < rows and 0 <= u1 < cols and claim[v1, u1] >= 0:
            p = claim[v1, u1]
            hx[d] = centre[p, 0]
            hy[d] = centre[p, 1]
            held[d] = True
            n_held += 1
        e = (d + 1) % directions
        v2, u2 = v1 + steps[e, 1], u1 + steps[e, 0]
        if 0 <= v2 < rows and 0 <= u2 < cols and claim[v2, u2] >= 0:
            p = claim[v2, u2]
            dx[d] = centre[p, 0]
            dy[d] = centre[p, 1]
            diagonal[d] = True
            n_diagonal += 1
    zero, one, two = np.float32(0), np.float32(1), np.float32(2)
    ax = ay = bx = by = zero
    na = nb = sx = sy = sw = zero
    pairs = 0
    for d in range(directions):
        e = (d + 1) % directions
        if held[d] and diagonal[d]:
            # the side of the cell from neighbour d to the corner runs along direction e
            s = np.float32(1.0) if e < half else np.float32(-1.0)
            if e % half == 0:
                ax += s * (dx[d] - hx[d])
                ay += s * (dy[d] - hy[d])
                na += one
            elif e % half == 1:
                bx += s * (dx[d] - hx[d])
                by += s * (dy[d] - hy[d])
                nb += one
            if held[e]:
                sx += hx[d] + hx[e] - dx[d]
                sy += hy[d] + hy[e] - dy[d]
                sw += one
        if held[e] and diagonal[d]:
            s = np.float32(1.0) if d < half else np.float32(-1.0)
            if d % half == 0:
                ax += s * (dx[d] - hx[e])
                ay += s * (dy[d] - hy[e])
                na += one
            elif d % half == 1:
                bx += s * (dx[d] - hx[e])
                by += s * (dy[d] - hy[e])
                nb += one
        if d < half and held[d] and held[d + half]:
            pairs += 1
            sx += np.float32(0.5) * (hx[d] + hx[d + half])
            sy += np.float32(0.5) * (hy[d] + hy[d + half])
            sw += one
            if d == 0:
                ax += hx[0] - hx[half]
                ay += hy[0] - hy[half]
                na += two
            elif d == 1:
                bx += hx[1] - hx[1 + half]
                by += hy[1] - hy[1 + half]
                nb += two
    if n_held == directions and (n_diagonal == directions or directions == 6):
        x = y = zero
        for d in range(directions):
            x += hx[d]
            y += hy[d]
        if directions == 4:
            for d in range(4):
                x -= np.float32(0.5) * dx[d]
                y -= np.float32(0.5) * dy[d]
            x *= np.float32(0.5)
            y *= np.float32(0.5)
        else:
            x *= np.float32(1 / 6)
            y *= np.float32(1 / 6)
        return x, y, FULL, ax / na, ay / na, bx / nb, by / nb
    for d in range(directions):
        if not held[d] or (held[(d + half) % directions]):
            continue
        v2, u2 = v + 2 * steps[d, 1], u + 2 * steps[d, 0]
        if not (0 <= v2 < rows and 0 <= u2 < cols) or claim[v2, u2] < 0:
            continue
        q = claim[v2, u2]
        lx = centre[q, 0] - hx[d]
        ly = centre[q, 1] - hy[d]
        s = np.float32(1.0) if d < half else np.float32(-1.0)
        if d % half == 0:
            ax += s * lx
            ay += s * ly
            na += one
        elif d % half == 1:
            bx += s * lx
            by += s * ly
            nb += one
        v3, u3 = v2 + steps[d, 1], u2 + steps[d, 0]
        if 0 <= v3 < rows and 0 <= u3 < cols and claim[v3, u3] >= 0:
            r = claim[v3, u3]
            sx += np.float32(3) * (hx[d] - centre[q, 0]) + centre[r, 0]
            sy += np.float32(3) * (hy[d] - centre[q, 1]) + centre[r, 1]
            sw += one
        else:
            sx += np.float32(0.5) * (hx[d] - lx)
            sy += np.float32(0.5) * (hy[d] - ly)
            sw += np.float32(0.5)
    if sw == 0 or na == 0 or nb == 0:
        return zero, zero, UNPREDICTED, zero, zero, zero, zero
    kind = INTERPOLATED if pairs > 0 else EXTRAPOLATED
    return sx / sw, sy / sw, kind, ax / na, ay / na, bx / nb, by / nb


@compiled
def lattice_error(ex, ey, ax, ay, bx, by):
    """Length of an image vector in units of the lattice basis (a, b), inf for a degenerate or mirrored basis."""
    det = ax * by - ay * bx
    if det <= 1e-3:
        return np.float32(np.inf)
    s = (ex * by - ey * bx) / det
    t = (ax * ey - ay * ex) / det
    return np.float32(np.sqrt(s * s + t * t))


@compiled
def grow(claim, holder_u, holder_v, banned_u, banned_v, centre, near, log_p, map_letters, steps, reach):
    """Claim free dots around the held ones until nothing fits any more; returns how many were added.

    banned (N,): an element that a dot may not hold again, because it was judged wrong there.
    """
    rows, cols = claim.shape
    directions = len(steps)
    queue_v = np.empty(rows * cols * 3, np.int32)
    queue_u = np.empty(rows * cols * 3, np.int32)
    waiting = np.zeros((rows, cols), np.bool_)
    tail = 0
    for v in range(rows):
        for u in range(cols):
            if claim[v, u] >= 0 or map_letters[v, u] < 0:
                continue
            for d in range(directions):
                vv, uu = v + steps[d, 1], u + steps[d, 0]
                if 0 <= vv < rows and 0 <= uu < cols and claim[vv, uu] >= 0:
                    queue_v[tail] = v
                    queue_u[tail] = u
                    waiting[v, u] = True
                    tail += 1
                    break
    head = 0
    added = 0
    while head < tail:
        v, u = queue_v[head], queue_u[head]
        head += 1
        waiting[v, u] = False
        x, y, kind, ax, ay, bx, by = predict(claim, centre, v, u, steps)
        if kind == UNPREDICTED:
            continue
        best = reach
        to = -1
        for d in range(directions):
            vv, uu = v + steps[d, 1], u + steps[d, 0]
            if not (0 <= vv < rows and 0 <= uu < cols) or claim[vv, uu] < 0:
                continue
            p = claim[vv, uu]
            for m in range(near.shape[1]):
                j = near[p, m]
                if j < 0:
                    break
                if holder_v[j] >= 0 or (banned_u[j] == u and banned_v[j] == v):
                    continue
                e = lattice_error(centre[j, 0] - x, centre[j, 1] - y, ax, ay, bx, by)
                if e >= reach:
                    continue
                e -= LETTER_WEIGHT * max(-2.0, log_p[j, map_letters[v, u]])
                if e < best:
                    best = e
                    to = j
        if to < 0 or (kind == EXTRAPOLATED and log_p[to, map_letters[v, u]] < -1.0):
            continue
        claim[v, u] = to
        holder_v[to] = v
        holder_u[to] = u
        added += 1
        for d in range(directions):
            vv, uu = v + steps[d, 1], u + steps[d, 0]
            if (
                0 <= vv < rows
                and 0 <= uu < cols
                and claim[vv, uu] < 0
                and map_letters[vv, uu] >= 0
                and not waiting[vv, uu]
                and tail < len(queue_v)
            ):
                queue_v[tail] = vv
                queue_u[tail] = uu
                waiting[vv, uu] = True
                tail += 1
    return added
