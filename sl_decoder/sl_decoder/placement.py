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
SWEEPS = 12  # most: all dots are updated at once, so that a label spreads by one of them a sweep
OUTSIDE = np.float32(-0.5)  # label, from -1 to 1, of the dots beyond the region in question
CONTOUR = (2.638, 1.848)  # growth of the number of closed paths with their length, square and honeycomb lattice
BEYOND = np.float32(-20)  # belief of a dot that would lie outside the map
DOUBTED = -0.5  # evidence of a dot's letter below which the region does not go on from it
EMPTY, FREE, MEMBER = -1, 0, 1  # marks of a lattice's cells: no dot, one that is not, or is in the region in question


@compiled
def flood(placement, voters, cell, at, steps, u, v, evidence, anywhere, map_letters, turn, mark, own, members):
    """The region of a lattice where the letters agree with a placement on balance, from the voters' windows outwards.

    Marks its cells (M,) int32, writes how much more evidence there is for their dots' letters than for any, own (M,),
    and lists them: members. Returns their number.
    """
    count = len(voters)
    for s in range(count):
        members[s] = at[voters[s]]
        mark[members[s]] = MEMBER
    head = 0
    while head < count:
        c = members[head]
        i = cell[c]
        head += 1
        mu, mv = on_map(placement[1:4], u[i], v[i], turn)
        if not is_inside(mu, mv, map_letters) or map_letters[mv, mu] < 0:
            own[c] = BEYOND
            continue
        own[c] = evidence[i, map_letters[mv, mu]] - anywhere[i]
        if own[c] < DOUBTED and head > len(voters):
            continue
        for step in steps:
            if mark[c + step] == FREE:
                mark[c + step] = MEMBER
                members[count] = c + step
                count += 1
    return count


@compiled
def sum_around(values, steps, region, out):
    """Sums (L,) of values (M,) over the cells that are so many steps from each of a region's: a slice of L cells."""
    out[:] = 0
    for step in steps:
        beside = values[region.start + step : region.stop + step]
        for k in range(len(out)):
            out[k] += beside[k]


@compiled
def solve_placement(region, steps, mark, own, coupling, sweeps, label, belief):
    """Log-odds belief (L,) that each dot of a region belongs to a placement, by mean-field over the lattice.

    mark, own (L,): see `flood`; label (M,): OUTSIDE where there is a dot, else 0. All cells of the region, a slice of
    L, are updated at once, the empty ones between them too: so the loops are vector code.
    """
    # the whole window decides which label is first: a dot alone would follow neighbours that are all in the wrong place
    sum_around(own, steps, region, belief)
    _relabel(mark[region], own[region], np.float32(1), label[region], belief)
    for _ in range(sweeps):
        sum_around(label, steps, region, belief)
        if _relabel(mark[region], own[region], np.float32(coupling), label[region], belief) < np.float32(0.05):
            break


@compiled
def _relabel(mark, own, coupling, label, belief):
    """Beliefs (L,), in place of the sums of the neighbours' labels, and the members' labels (L,) that follow.

    Returns by how much these have moved at most."""
    moved = np.float32(0)
    for k in range(len(belief)):
        belief[k] = own[k] + coupling * belief[k]
        t = tangent(np.float32(0.5) * belief[k])
        t = t if mark[k] == MEMBER else label[k]
        moved = max(moved, abs(t - label[k]))
        label[k] = t
    return moved


@compiled
def evidence_of_region(region, links, mark, own, belief, least, left_out, crossed):
    """Evidence (log-likelihood ratio) that the members above the `least` belief lie in a placement.

    Of the many regions of a lattice the one was chosen whose letters happen to agree. Regions whose boundary crosses n
    links number CONTOUR to the power of n, so each link to a dot of the lattice that was left out costs the logarithm,
    and no region gains by being chosen. own (M,), belief (L,): see `solve_placement`; links: steps to the neighbours;
    left_out (M,): one for each dot, before and after; crossed (L,): work space.
    """
    mark, own, here = mark[region], own[region], left_out[region]
    for k in range(len(belief)):
        placed = mark[k] == MEMBER and (belief[k] > least or own[k] <= BEYOND)
        here[k] = np.float32(0) if placed else here[k]
    sum_around(left_out, links, region, crossed)
    cost = np.float32(np.log(CONTOUR[0] if len(links) == 4 else CONTOUR[1]))
    total = np.float32(0)
    for k in range(len(belief)):
        placed = mark[k] == MEMBER and belief[k] > least
        total += own[k] - cost * crossed[k] if placed else np.float32(0)
        here[k] = np.float32(mark[k] != EMPTY)
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
    evidence,
    anywhere,
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
    element, or one dot, the better supported keeps it. evidence (N, A), anywhere (N,): of the letters and of any of
    them, see `letter_model`. Returns the number of accepted placements.
    """
    n = len(at)
    mark = np.empty(len(cell), np.int32)
    label, own, left_out, belief, work = np.zeros((5, len(cell)), np.float32)
    for c in range(len(cell)):
        mark[c] = FREE if cell[c] >= 0 else EMPTY
        label[c] = OUTSIDE if cell[c] >= 0 else np.float32(0)
        left_out[c] = np.float32(cell[c] >= 0)
    members = np.empty(n, np.int32)
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
        steps = window[1:, 1] * width[voters[0]] + window[1:, 0]
        links = steps[:: len(steps) // len(turn)]
        count = flood(
            found[p], voters[:m], cell, at, steps, u, v, evidence, anywhere, map_letters, turn, mark, own, members
        )
        first = members[:count].min()
        region = slice(first, members[:count].max() + 1)
        here = belief[: region.stop - first]
        solve_placement(region, steps, mark, own, coupling, sweeps, label, here)
        gain = evidence_of_region(region, links, mark, own, here, least_belief, left_out, work[: len(here)])
        if gain >= (first_evidence if accepted == 0 else next_evidence):
            accepted += 1
            for c in members[:count]:
                i = cell[c]
                if here[c - first] <= least_belief or holder_v[i] >= 0:
                    continue
                mu, mv = on_map(found[p, 1:4], u[i], v[i], turn)
                mine = min(here[c - first], gain)
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
        for c in members[:count]:
            mark[c], label[c], own[c] = FREE, OUTSIDE, 0
    return accepted
