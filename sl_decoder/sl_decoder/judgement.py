"""Judgement of claimed dots: letter, place, size and neighbours, added up to the log-odds of being right.

Each piece of evidence is a log-likelihood ratio between "the dot is this element" and "it is something else that
happened to lie here" (another surface across a depth edge, a highlight, half a dot at an edge). Support of the
neighbours counts along the axes through the dot: between two sound neighbours a dot is almost surely right, beyond
the last sound one it has to convince by itself. Beliefs and support are iterated (mean field).
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.approximation import exponential, logarithm, tangent
from sl_decoder.compiled import compiled
from sl_decoder.footprints import thin_evidence, thin_statistics
from sl_decoder.growth import EXTRAPOLATED, FULL, UNPREDICTED
from sl_decoder.measures import around_sum, index_of, measure

UNHELD = -20.0  # belief where no dot is held
# residuals of true dots from their prediction, in lattice units: mixtures per kind of prediction
PLACE_SIGMA = np.array([[0.010, 0.030, 0.10], [0.018, 0.05, 0.12], [0.03, 0.07, 0.12]], np.float32)
PLACE_SHARE = np.array([[0.78, 0.20, 0.02], [0.68, 0.20, 0.12], [0.45, 0.35, 0.20]], np.float32)
PLACE_FLOOR = 0.02  # density of true dots anywhere
PLACE_MOST = 4.0
# beyond (some 99.8 % of true dots lie within) the dot is half lit, merged or not on this surface: its centre is wrong
PLACE_LIMIT = np.array([0.14, 0.22, 0.30], np.float32)
RECOVERED_LIMIT = 0.65  # times that for dots that were only found where they were expected: faint, or next to an edge
# dots of a few pixels have noisier centres: the image's median residual adds to the above
NOISE_VARIANCE = 0.5  # times its square to the variances
NOISE_LIMIT = 4.0  # times it, below which no dot is too far off
OFF_PLACE = 12.0
ROUGHER = 1.6  # times the surroundings' mean residual, from which a dot is out of line
SMOOTH_LIMIT = 0.07  # but never below this, nor below SMOOTH_FACTOR times the image's median residual
SMOOTH_FACTOR = 8.0
RECOVERED = -2.0  # log-odds of such a dot before all evidence: what was not segmented is often half lit, or half hidden
THIN_KIND = np.array(
    [1.0, 1.2, 1.5, 1.5], np.float32
)  # times the spread, per kind: there are neighbours on one side only
LOST_FREE = 0.3  # px of a lost part that noise explains
LOST_WEIGHT = 7.0  # log-odds against the dot per px beyond
PAIR = 1.2  # support of two sound neighbours on opposite sides
SINGLE = 0.3  # support of one sound neighbour
SWEEPS = 6


@compiled
def judge(
    claim,
    segmented,
    centre,
    area,
    covariance,
    log_p,
    map_letters,
    lattice_steps,
    window,
    pixel,
    limit,
    most,
    kind_of,
    belief,
    holder_u,
    holder_v,
    banned_u,
    banned_v,
):
    """Judge all held elements; release the worst below `limit` and judge again, until none is left or `most` times.

    claim (V, U) and the arrays of the dots as in `Interpretation`; dots from number `segmented` on were recovered;
    pixel: size of a pixel of the camera in those in which they were measured. Writes kind_of and belief (V, U).
    """
    rows, cols = claim.shape
    for _ in range(most):
        measures = measure(claim, segmented, centre, area, covariance, log_p, map_letters, lattice_steps)
        own = own_evidence(claim, segmented, measures, pixel)
        solve(measures.held, own, window, cols + 2)
        for v in range(rows):
            for u in range(cols):
                k = index_of(v, u, cols)
                belief[v, u] = own[k] if claim[v, u] >= 0 else np.float32(UNHELD)
                kind_of[v, u] = np.int8(measures.kind[k])
        if release_worst(claim, belief, limit, holder_u, holder_v, banned_u, banned_v) == 0:
            return


@compiled
def typical_error(measures):
    """Median position error [lattice units] of the image's dots with whole rings, in steps of 0.001."""
    histogram = np.zeros(200, np.int32)
    n = 0
    for k in range(len(measures.held)):
        if measures.held[k] > 0 and measures.kind[k] == FULL:
            histogram[min(199, int(measures.error[k] * np.float32(1000)))] += 1
            n += 1
    middle = 0
    below = 0
    while middle < 199 and 2 * (below + histogram[middle]) < n:
        below += histogram[middle]
        middle += 1
    return np.float32(0.001) * np.float32(middle)


@compiled
def own_evidence(claim, segmented, measures, pixel):
    """Log-odds (L,) of each held element by itself; dots from number `segmented` on were recovered.

    pixel: size of a pixel of the camera in those in which it was measured.
    """
    rows, cols = claim.shape
    room = len(measures.held)
    recovered = np.zeros(room, np.float32)
    for v in range(rows):
        for u in range(cols):
            recovered[index_of(v, u, cols)] = np.float32(claim[v, u] >= segmented)
    rough = roughness(measures, cols + 2)
    middle, spread = thin_statistics(measures.held, measures.thin, measures.kind)
    noise = typical_error(measures)
    own = np.empty(room, np.float32)
    for kind in range(UNPREDICTED + 1):
        _place_evidence(np.float32(kind), measures.error, measures.kind, noise, rough, recovered, own)
    for kind in range(UNPREDICTED + 1):
        _add_thin_evidence(np.float32(kind), measures.thin, measures.kind, middle, spread * THIN_KIND[kind], own)
    weight = np.float32(LOST_WEIGHT)
    for k in range(room):
        size = max(np.float32(0), abs(measures.size[k]) - np.float32(0.25))
        lost = max(np.float32(0), measures.lost[k] / pixel - np.float32(LOST_FREE))
        own[k] += measures.letter[k] - np.float32(2) * size - weight * lost + np.float32(RECOVERED) * recovered[k]
    return own


@compiled
def roughness(measures, width):
    """Mean error (L,) of the dots around each that are predicted from both sides; infinite for less than four."""
    room = len(measures.held)
    counted, error = np.empty(room, np.float32), np.empty(room, np.float32)
    for k in range(room):
        counted[k] = np.float32(measures.held[k] > 0 and measures.kind[k] < EXTRAPOLATED)
        error[k] = counted[k] * measures.error[k]
    number, total = np.zeros(room, np.float32), np.zeros(room, np.float32)
    around_sum(counted, width, number)
    around_sum(error, width, total)
    for k in range(room):
        total[k] = total[k] / max(number[k], np.float32(1)) if number[k] >= 4 else np.float32(np.inf)
    return total


@compiled
def _place_evidence(kind, error, kind_of, noise, rough, recovered, own):
    """Log-likelihood ratio own (L,) of the places of the dots of one kind of prediction."""
    if kind == UNPREDICTED:  # where it ought to be cannot be told: nor can what it is
        for k in range(len(own)):
            own[k] = np.float32(-OFF_PLACE) if kind_of[k] == kind else own[k]
        return
    c = np.int64(kind)
    variance = PLACE_SIGMA[c] * PLACE_SIGMA[c] + np.float32(NOISE_VARIANCE) * noise * noise
    height = PLACE_SHARE[c] / (np.float32(2 * np.pi) * variance)
    slope = np.float32(-0.5) / variance
    s0, s1, s2, h0, h1, h2 = slope[0], slope[1], slope[2], height[0], height[1], height[2]
    most = max(PLACE_LIMIT[c], np.float32(NOISE_LIMIT) * (np.float32(1) + np.float32(0.5) * kind) * noise)
    # out of line with its surroundings: their own residuals tell how rough the surface is
    smooth = max(np.float32(SMOOTH_LIMIT), np.float32(SMOOTH_FACTOR) * noise) * (np.float32(1) + kind)
    lone = np.float32(np.inf) if kind >= EXTRAPOLATED else smooth
    less = np.float32(1 - RECOVERED_LIMIT)
    for k in range(len(own)):
        e2 = error[k] * error[k]
        density = np.float32(PLACE_FLOOR) + h0 * exponential(s0 * e2) + h1 * exponential(s1 * e2)
        density += h2 * exponential(s2 * e2)
        limit = most * (np.float32(1) - less * recovered[k])
        limit = min(limit, max(lone, np.float32(ROUGHER) * rough[k]))
        place = min(logarithm(density), np.float32(PLACE_MOST))
        place = np.float32(-OFF_PLACE) if error[k] > limit else place
        own[k] = place if kind_of[k] == kind else own[k]


@compiled
def _add_thin_evidence(kind, thin, kind_of, middle, spread, own):
    """Adds the evidence of the footprints of the dots of one kind of prediction."""
    for k in range(len(own)):
        ratio = thin_evidence(thin[k], middle, spread)
        own[k] += ratio if kind_of[k] == kind else np.float32(0)


@compiled
def release_worst(claim, belief, least, holder_u, holder_v, banned_u, banned_v):
    """Release held elements below `least` that are the worst among their neighbours; returns how many.

    Only the worst: a wrong dot spoils the predictions around it, and its neighbours deserve another judgement without
    it.
    """
    rows, cols = claim.shape
    released = 0
    doomed = np.zeros((rows, cols), np.bool_)
    for v in range(rows):
        for u in range(cols):
            if claim[v, u] < 0 or belief[v, u] >= least:
                continue
            worst = True
            for vv in range(max(0, v - 1), min(rows, v + 2)):
                for uu in range(max(0, u - 1), min(cols, u + 2)):
                    if claim[vv, uu] >= 0 and belief[vv, uu] < belief[v, u]:
                        worst = False
            doomed[v, u] = worst
    for v in range(rows):
        for u in range(cols):
            if doomed[v, u]:
                i = claim[v, u]
                banned_u[i] = u
                banned_v[i] = v
                holder_u[i] = -1
                holder_v[i] = -1
                claim[v, u] = -1
                released += 1
    return released


@compiled
def release_doubtful(claim, belief, kind_of, segmented, cut, limit, rim, holder_u, holder_v):
    """Release held elements whose belief is below what is asked, and dots that are cut; returns how many are left.

    rim (2, 4) float32: log-odds asked beyond the limit per kind of prediction, of segmented dots and of those from
    number `segmented` on, which were recovered; cut (N,) bool of the segmented dots. As much more likely as the first
    says is a false dot there: it is taken off the beliefs of those that are left.
    """
    held = 0
    for v in range(claim.shape[0]):
        for u in range(claim.shape[1]):
            i = claim[v, u]
            if i < 0:
                continue
            recovered = i >= segmented
            kind = kind_of[v, u]
            if belief[v, u] < limit + rim[np.int64(recovered), kind] or (not recovered and cut[i]):
                holder_u[i] = -1
                holder_v[i] = -1
                claim[v, u] = -1
            else:
                belief[v, u] -= rim[0, kind]
                held += 1
    return held


@compiled
def solve(held, own, window, width):
    """Beliefs, in place of own (L,): log-odds that each held element is right, own evidence and neighbours'.

    held (L,): one or zero; width: of the rows. Support counts along the axes through an element.
    """
    label = np.empty(len(own), np.float32)  # from -1 to 1; 0 for what is not held
    belief = np.zeros(len(own), np.float32)
    for k in range(len(own)):
        label[k] = held[k] * tangent(np.float32(0.5) * own[k])
    half = (len(window) - 1) // 2
    first, last = width + 1, len(own) - width - 1
    for _ in range(SWEEPS):
        belief[:] = own
        for p in range(1, half + 1):
            step = window[p, 1] * width + window[p, 0]
            one, two = slice(first + step, last + step), slice(first - step, last - step)
            _support(held[one], label[one], held[two], label[two], belief[first:last])
        moved = np.float32(0)
        for k in range(first, last):
            t = held[k] * tangent(np.float32(0.5) * belief[k])
            moved = max(moved, abs(t - label[k]))
            label[k] = t
        if moved < np.float32(0.05):
            break
    own[:] = belief


@compiled
def _support(held_one, one, held_two, two, belief):
    """Adds what the neighbours on opposite sides say."""
    for k in range(len(belief)):
        both = held_one[k] * held_two[k]
        pair = np.float32(PAIR) * min(one[k], two[k])
        belief[k] += pair if both > 0 else np.float32(SINGLE) * (one[k] + two[k])
