"""Windows: components laid out on their lattices, whose windows vote for where they lie in the map.

All windows of a correctly linked component name the same placement: a rotation and a shift from lattice to map
coordinates. So windows vote for placements (a Hough transform over the discrete poses).
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.codebook import code_at, find_code
from sl_decoder.compiled import compiled


@compiled
def lay_out(component, u, v, conflicts, count, smallest):
    """Lay the components with at least `smallest` dots out on their lattices.

    Returns cell (M,) int32 dot index or -1, all components in one flat array; at (N,) int32 the cell of each dot or -1;
    width (N,) int32 row length of the component's block; and how many components. Dots that share a cell are in
    conflict and left out.
    """
    n = len(component)
    size = np.zeros(count, np.int64)
    u0 = np.full(count, 1 << 30)
    u1 = np.full(count, -(1 << 30))
    v0 = np.full(count, 1 << 30)
    v1 = np.full(count, -(1 << 30))
    for i in range(n):
        c = component[i]
        if c < 0:
            continue
        size[c] += 1
        u0[c] = min(u0[c], u[i])
        u1[c] = max(u1[c], u[i])
        v0[c] = min(v0[c], v[i])
        v1[c] = max(v1[c], v[i])
    base = np.full(count, -1)
    total = laid_out = 0
    for c in range(count):
        if size[c] < smallest:
            continue
        room = (u1[c] - u0[c] + 3) * (v1[c] - v0[c] + 3)
        if room > 500 * size[c] + 1000:
            continue
        base[c] = total
        total += room
        laid_out += 1
    cell = np.full(total + 1, -1, np.int32)
    at = np.full(n, -1, np.int32)
    width = np.zeros(n, np.int32)
    for i in range(n):
        c = component[i]
        if c < 0 or base[c] < 0:
            continue
        w = u1[c] - u0[c] + 3
        a = base[c] + (v[i] - v0[c] + 1) * w + (u[i] - u0[c] + 1)
        width[i] = w
        if cell[a] >= 0:
            conflicts[i] = True
            conflicts[cell[a]] = True
        else:
            cell[a] = i
            at[i] = a
    for i in range(n):
        if conflicts[i] and at[i] >= 0:
            if cell[at[i]] == i:
                cell[at[i]] = -1
            at[i] = -1
    return cell, at, width, laid_out


@compiled
def window_votes(cell, at, width, component, u, v, letter, window, alphabet, codes, values, map_codes, turn):
    """Look every whole window up.

    Returns votes (V, 4) int32: dot at the centre, orientation k, shift u, shift v (map = turn[k] @ (u, v) + shift).
    A window is first compared with the map where the last vote of its component puts it: mostly it is that one.
    """
    n = len(at)
    votes = np.empty((2 * n + 16, 4), np.int32)
    last = np.full(n, -1, np.int32)  # vote of each component
    member = np.empty(len(window), np.int32)
    m = 0
    for i in range(n):
        if at[i] < 0 or m == len(votes):
            continue
        code = code_at(cell, at[i], width[i], letter, window, alphabet, member)
        if code < 0:
            continue
        before = last[component[i]]
        if before >= 0:
            mu, mv = on_map(votes[before, 1:], u[i], v[i], turn)
            if is_inside(mu, mv, map_codes[0]) and map_codes[votes[before, 1], mv, mu] == code:
                votes[m, 0] = i
                votes[m, 1:] = votes[before, 1:]
                m += 1
                continue
        f = find_code(codes, code)
        while 0 <= f < len(codes) and codes[f] == code and m < len(votes):
            k = values[f, 2]
            votes[m, 0] = i
            votes[m, 1] = k
            votes[m, 2] = values[f, 0] - (turn[k, 0, 0] * u[i] + turn[k, 0, 1] * v[i])
            votes[m, 3] = values[f, 1] - (turn[k, 1, 0] * u[i] + turn[k, 1, 1] * v[i])
            last[component[i]] = m
            m += 1
            f += 1
    return votes[:m]


@compiled
def on_map(placement, u, v, turn):
    """Map coordinates of lattice coordinates under a placement: orientation k, shift u, shift v."""
    k = placement[0]
    return turn[k, 0, 0] * u + turn[k, 0, 1] * v + placement[1], turn[k, 1, 0] * u + turn[k, 1, 1] * v + placement[2]


@compiled
def is_inside(mu, mv, element):
    """Whether map coordinates lie inside of an array of the map's elements (V, U)."""
    return 0 <= mv < element.shape[0] and 0 <= mu < element.shape[1]


@compiled
def rank_placements(votes, component, smallest):
    """Distinct placements with at least `smallest` votes, most votes first: (P, 5) int32 component, k, u, v, votes;
    and for each vote the index of its placement or -1."""
    m = len(votes)
    size = 64
    while size < 2 * m:
        size *= 2
    table = np.full(size, -1, np.int64)
    slot = np.empty(size, np.int32)
    found = np.empty((m, 5), np.int32)
    of = np.empty(m, np.int32)
    n = 0
    for i in range(m):
        c = component[votes[i, 0]]
        key = ((np.int64(c) * 8 + votes[i, 1]) * 65536 + votes[i, 2] + 32768) * 65536 + votes[i, 3] + 32768
        h = ((key * 0x9E3779B97F4A7C1) >> 20) & (size - 1)
        while table[h] >= 0 and table[h] != key:
            h = (h + 1) & (size - 1)
        if table[h] < 0:
            table[h] = key
            slot[h] = n
            found[n, 0] = c
            found[n, 1] = votes[i, 1]
            found[n, 2] = votes[i, 2]
            found[n, 3] = votes[i, 3]
            found[n, 4] = 0
            n += 1
        of[i] = slot[h]
        found[slot[h], 4] += 1
    rank = np.argsort(-found[:n, 4], kind="mergesort")
    position = np.full(n, -1, np.int32)
    kept = 0
    for p in range(n):
        if found[rank[p], 4] >= smallest:
            position[rank[p]] = p
            kept += 1
    for i in range(m):
        of[i] = position[of[i]]
    return found[:n][rank[:kept]], of
