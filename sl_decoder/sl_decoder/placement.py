"""Where a lattice component lies in the map: every window votes, the letters of all its dots decide.

All windows of a correctly linked component name the same placement: a rotation and a shift from lattice to map
coordinates. So windows vote for placements (a Hough transform over the discrete poses), and a placement is verified
letter by letter. Links that jump over a depth edge make one component out of parts with different placements; a
two-label field (in this placement or not) over the lattice, solved by mean-field message passing, cuts them apart:
own letter against neighbours'.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.approximation import tangent
from sl_decoder.codebook import code_at, find_code
from sl_decoder.compiled import compiled

COUPLING = 0.8  # log-odds that a dot shares its neighbour's label
SWEEPS = 6
OUTSIDE = np.float32(-0.5)  # label, from -1 to 1, of the dots beyond the region in question
CONTOUR = (2.638, 1.848)  # growth of the number of closed paths with their length, square and honeycomb lattice
BEYOND = -20.0  # belief of a dot that would lie outside the map
INSIDE, OFF_MAP = 1, 2  # marks of a placement's dots


@compiled
def lay_out(component, u, v, conflicts, count, smallest):
    """Lay the components with at least `smallest` dots out on their lattices.

    Returns cell (M,) int32 dot index or -1, all components in one flat array; at (N,) int32 the cell of each dot or -1;
    width (N,) int32 row length of the component's block. Dots that share a cell are in conflict and left out.
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
    total = 0
    for c in range(count):
        if size[c] < smallest:
            continue
        room = (u1[c] - u0[c] + 3) * (v1[c] - v0[c] + 3)
        if room > 500 * size[c] + 1000:
            continue
        base[c] = total
        total += room
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
    return cell, at, width


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
    while size < 4 * m:
        size *= 2
    table = np.full(size, -1, np.int64)
    slot = np.zeros(size, np.int32)
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


@compiled
def solve_placement(
    placement,
    voters,
    cell,
    at,
    width,
    u,
    v,
    log_p,
    map_letters,
    window,
    turn,
    coupling,
    sweeps,
    belief,
    label,
    work,
    members,
):
    """Log-odds that each dot of the component belongs to a placement, by mean-field over the lattice.

    Starts from the windows that voted and grows outwards over the lattice; belief (N,) float32 is written for the
    returned number of `members`. work (N,), label (N + 1,): work space, 0 and OUTSIDE (last: 0) before and after.
    """
    around = window[:, 1] * width[voters[0]] + window[:, 0]
    count = 0
    # region: flood from the voters while the letters agree on balance
    for s in range(len(voters)):
        here = at[voters[s]]
        for step in around:
            j = cell[here + step]
            if work[j] == 0:
                work[j] = 1
                members[count] = j
                count += 1
    head = 0
    while head < count:
        i = members[head]
        head += 1
        mu, mv = on_map(placement[1:4], u[i], v[i], turn)
        if not is_inside(mu, mv, map_letters) or map_letters[mv, mu] < 0:
            belief[i] = BEYOND
            continue
        belief[i] = log_p[i, map_letters[mv, mu]]
        if belief[i] < -0.5:
            continue
        for step in around[1:]:
            j = cell[at[i] + step]
            if j >= 0 and work[j] == 0:
                work[j] = 1
                members[count] = j
                count += 1
    own = belief[members[:count]].copy()
    for s in range(count):
        label[members[s]] = tangent(own[s])
    for _ in range(sweeps):
        moved = np.float32(0)
        for s in range(count):
            i = members[s]
            total = np.float32(0)
            here = at[i]
            for step in around[1:]:
                total += label[cell[here + step]]  # -1, no dot: the last, zero
            belief[i] = own[s] + np.float32(coupling) * total
            t = tangent(np.float32(0.5) * belief[i])
            moved = max(moved, abs(t - label[i]))
            label[i] = t
        if moved < np.float32(0.05):
            break
    for s in range(count):
        work[members[s]] = 0
        label[members[s]] = OUTSIDE
    return count, own


@compiled
def evidence_of_region(members, own, belief, least, cell, at, width, window, directions, work):
    """Evidence (log-likelihood ratio) that the members above the `least` belief lie in a placement.

    Of the many regions of a lattice the one was chosen whose letters happen to agree. Regions whose boundary crosses n
    links number CONTOUR to the power of n, so each link to a dot of the lattice that was left out costs the logarithm,
    and no region gains by being chosen. own (M,): evidence of the members; work (N,) int32: zero before and after.
    """
    step = (len(window) - 1) // directions
    links = (window[:, 1] * width[members[0]] + window[:, 0])[1::step]
    cost = np.log(CONTOUR[0] if directions == 4 else CONTOUR[1])
    for s in range(len(members)):
        work[members[s]] = INSIDE if belief[members[s]] > least else OFF_MAP if own[s] <= BEYOND else 0
    total = 0.0
    for s in range(len(members)):
        i = members[s]
        if work[i] == INSIDE:
            total += own[s]
            for link in links:
                j = cell[at[i] + link]
                if j >= 0 and work[j] == 0:
                    total -= cost
    for s in range(len(members)):
        work[members[s]] = 0
    return total


@compiled
def place(
    found,
    of,
    votes,
    cell,
    at,
    width,
    u,
    v,
    log_p,
    map_letters,
    window,
    turn,
    coupling,
    sweeps,
    first_evidence,
    next_evidence,
    least_belief,
    claim,
    holder_u,
    holder_v,
):
    """Accept placements by their evidence and let their dots claim the map's elements.

    The first placement of an image needs `first_evidence` (log-likelihood ratio over all windows, orientations and
    trials), the others `next_evidence`, since the pattern is then known to be there. Where two placements claim one
    element, or one dot, the better supported keeps it. Returns number of accepted placements and their evidence.
    """
    n = len(at)
    belief = np.empty(n, np.float32)
    label = np.full(n + 1, OUTSIDE, np.float32)
    label[n] = 0
    work = np.zeros(n, np.int32)
    members = np.empty(n + 16, np.int32)
    strength = np.full(n, -1e9, np.float32)
    n_found = len(found)
    begin = np.zeros(n_found + 1, np.int64)
    for i in range(len(of)):
        if of[i] >= 0:
            begin[of[i] + 1] += 1
    for p in range(n_found):
        begin[p + 1] += begin[p]
    fill = begin[:-1].copy()
    sorted_votes = np.empty(begin[n_found], np.int32)
    for i in range(len(of)):
        if of[i] >= 0:
            sorted_votes[fill[of[i]]] = votes[i, 0]
            fill[of[i]] += 1
    accepted = 0
    evidence = 0.0
    voters = np.empty(n, np.int32)
    for p in range(n_found):
        m = 0
        for s in range(begin[p], begin[p + 1]):
            i = sorted_votes[s]
            if holder_v[i] < 0:
                voters[m] = i
                m += 1
        if m == 0:
            continue
        count, own = solve_placement(
            found[p],
            voters[:m],
            cell,
            at,
            width,
            u,
            v,
            log_p,
            map_letters,
            window,
            turn,
            coupling,
            sweeps,
            belief,
            label,
            work,
            members,
        )
        total = evidence_of_region(members[:count], own, belief, least_belief, cell, at, width, window, len(turn), work)
        if total < (first_evidence if accepted == 0 else next_evidence):
            continue
        accepted += 1
        evidence += total
        for s in range(count):
            i = members[s]
            if belief[i] <= least_belief:
                continue
            mu, mv = on_map(found[p, 1:4], u[i], v[i], turn)
            mine = min(belief[i], np.float32(total))
            if holder_v[i] >= 0:
                continue
            other = claim[mv, mu]
            if other >= 0:
                if strength[other] >= mine:
                    continue
                holder_v[other] = -1
                holder_u[other] = -1
            claim[mv, mu] = i
            holder_v[i] = mv
            holder_u[i] = mu
            strength[i] = mine
    return accepted, evidence
