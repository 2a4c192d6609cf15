"""Where a lattice component lies in the map: the letters of all its dots decide on what its windows vote for.

A placement is verified letter by letter. Links that jump over a depth edge make one component out of parts with
different placements; a two-label field (in this placement or not) over the lattice, solved by mean-field message
passing, cuts them apart: own letter against neighbours'.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.approximation import tangent
from sl_decoder.compiled import compiled
from sl_decoder.windows import is_inside, on_map

COUPLING = 0.8  # log-odds that a dot shares its neighbour's label
SWEEPS = 6
OUTSIDE = np.float32(-0.5)  # label, from -1 to 1, of the dots beyond the region in question
CONTOUR = (2.638, 1.848)  # growth of the number of closed paths with their length, square and honeycomb lattice
BEYOND = -20.0  # belief of a dot that would lie outside the map
INSIDE, OFF_MAP = 1, 2  # marks of a placement's dots


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
    around = window[1:, 1] * width[voters[0]] + window[1:, 0]
    # region: flood from the voters' windows while the letters agree on balance
    count = len(voters)
    for s in range(count):
        work[voters[s]] = 1
        members[s] = voters[s]
    head = 0
    while head < count:
        i = members[head]
        head += 1
        mu, mv = on_map(placement[1:4], u[i], v[i], turn)
        if not is_inside(mu, mv, map_letters) or map_letters[mv, mu] < 0:
            belief[i] = -20.0
            continue
        belief[i] = log_p[i, map_letters[mv, mu]]
        if belief[i] < -0.5 and head > len(voters):
            continue
        here = at[i]
        for step in around:
            j = cell[here + step]
            if j >= 0 and work[j] == 0:
                work[j] = 1
                members[count] = j
                count += 1
    own = belief[members[:count]].copy()
    # the whole window decides which label is first: a dot alone would follow neighbours that are all in the wrong place
    for s in range(count):
        total = own[s]
        for step in around[1:]:
            j = cell[at[members[s]] + step]
            total += belief[j] if j >= 0 and work[j] != 0 else np.float32(0)
        label[members[s]] = tangent(np.float32(0.5) * total)
    for _ in range(sweeps):
        moved = np.float32(0)
        for s in range(count):
            i = members[s]
            total = np.float32(0)
            here = at[i]
            for step in around:
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
