"""Judgement of claimed dots: letter, place, size and neighbours, added up to the log-odds of being right.

Each piece of evidence is a log-likelihood ratio between "the dot is this element" and "it is something else that
happened to lie here" (another surface across a depth edge, a highlight, half a dot at an edge). Support of the
neighbours counts along the axes through the dot: between two sound neighbours a dot is almost surely right, beyond
the last sound one it has to convince by itself. Beliefs and support are iterated (mean field).
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sl_decoder.compiled import compiled
from sl_decoder.footprints import lost_part, thin_evidence, thin_statistics, thinness
from sl_decoder.growth import EXTRAPOLATED, FULL, UNPREDICTED, lattice_error, predict

# residuals of true dots from their prediction, in lattice units: mixtures per kind of prediction
PLACE_SIGMA = np.array([[0.010, 0.030, 0.10], [0.018, 0.05, 0.12], [0.03, 0.07, 0.12]], np.float32)
PLACE_SHARE = np.array([[0.78, 0.20, 0.02], [0.68, 0.20, 0.12], [0.45, 0.35, 0.20]], np.float32)
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


class Measures(NamedTuple):
    """What is known of each held element by itself, arrays (V, U).

    letter: log-likelihood ratio of its letter; error: of its position [lattice units]; kind: of the prediction; size:
    log of the core's area per lattice cell, relative to the neighbours'; thin, lost: see `thinness` (nan where there
    are too few neighbours to compare with) and `lost_part` in footprints.py. float32, kind int8.
    """

    letter: np.ndarray
    error: np.ndarray
    kind: np.ndarray
    size: np.ndarray
    thin: np.ndarray
    lost: np.ndarray


def no_measures(shape: tuple[int, ...]) -> Measures:
    """Measures of a map of this shape (V, U) before any dot is held."""
    letter, error, size, thin, lost = (np.zeros(shape, np.float32) for _ in range(5))
    return Measures(letter, error, np.full(shape, UNPREDICTED, np.int8), size, thin, lost)


@compiled
def gather(claim, centre, area, covariance, log_p, map_letters, steps, measures):
    """Measure all held elements."""
    letter, error, kind_of, size, thin, lost = measures
    rows, cols = claim.shape
    absolute = np.empty((rows, cols), np.float32)
    off = np.zeros((rows, cols, 2), np.float32)
    for v in range(rows):
        for u in range(cols):
            i = claim[v, u]
            if i < 0:
                continue
            x, y, kind, ax, ay, bx, by = predict(claim, centre, v, u, steps)
            letter[v, u] = log_p[i, map_letters[v, u]]
            kind_of[v, u] = kind
            absolute[v, u] = np.float32(np.nan)
            error[v, u] = np.float32(1.0)
            if kind != UNPREDICTED:
                off[v, u, 0], off[v, u, 1] = centre[i, 0] - x, centre[i, 1] - y
                error[v, u] = min(lattice_error(centre[i, 0] - x, centre[i, 1] - y, ax, ay, bx, by), np.float32(1.0))
                det = ax * by - ay * bx
                if det > 0:
                    absolute[v, u] = np.log(area[i] / det)
    for v in range(rows):
        for u in range(cols):
            if claim[v, u] < 0:
                continue
            total = np.float32(0)
            n = 0
            n0 = n1 = n2 = np.float32(0)
            m = 0
            for vv in range(max(0, v - 1), min(rows, v + 2)):
                for uu in range(max(0, u - 1), min(cols, u + 2)):
                    j = claim[vv, uu]
                    if j < 0 or (vv == v and uu == u):
                        continue
                    n0 += covariance[j, 0]
                    n1 += covariance[j, 1]
                    n2 += covariance[j, 2]
                    m += 1
                    if absolute[vv, uu] == absolute[vv, uu]:
                        total += absolute[vv, uu]
                        n += 1
            thin[v, u] = np.float32(np.nan)
            lost[v, u] = np.float32(0)
            if m >= 2:
                i = claim[v, u]
                n0, n1, n2 = n0 / m, n1 / m, n2 / m
                thin[v, u] = thinness(covariance[i, 0], covariance[i, 1], covariance[i, 2], n0, n1, n2)
                dx, dy = off[v, u, 0], off[v, u, 1]
                lost[v, u] = lost_part(claim, centre, covariance, v, u, steps, dx, dy, n0, n1, n2)
            size[v, u] = absolute[v, u] - total / n if n > 0 and absolute[v, u] == absolute[v, u] else np.float32(0)


@compiled
def typical_error(claim, error, kind_of):
    """Median position error [lattice units] of the image's dots with whole rings, in steps of 0.001."""
    rows, cols = claim.shape
    histogram = np.zeros(200, np.int32)
    n = 0
    for v in range(rows):
        for u in range(cols):
            if claim[v, u] >= 0 and kind_of[v, u] == FULL:
                histogram[min(199, int(error[v, u] * 1000))] += 1
                n += 1
    middle = 0
    below = 0
    while middle < 199 and 2 * (below + histogram[middle]) < n:
        below += histogram[middle]
        middle += 1
    return np.float32(0.001) * middle


@compiled
def own_evidence(claim, segmented, measures, pixel, own):
    """Log-odds (V, U) of each held element by itself; dots from number `segmented` on were recovered.

    pixel: size of a pixel of the camera in those in which it was measured.
    """
    letter, error, kind_of, size, thin, lost = measures
    rows, cols = claim.shape
    thin_middle, thin_spread = thin_statistics(claim, thin, kind_of)
    noise = typical_error(claim, error, kind_of)
    smooth_limit = max(np.float32(SMOOTH_LIMIT), np.float32(SMOOTH_FACTOR) * noise)
    for v in range(rows):
        for u in range(cols):
            if claim[v, u] < 0:
                continue
            kind = kind_of[v, u]
            e2 = np.float32(-0.5) * error[v, u] * error[v, u]
            if kind == UNPREDICTED:
                place = np.float32(-OFF_PLACE)  # where it ought to be cannot be told: nor can what it is
            else:
                density = np.float32(0.02)
                for c in range(3):
                    s2 = PLACE_SIGMA[kind, c] * PLACE_SIGMA[kind, c] + np.float32(NOISE_VARIANCE) * noise * noise
                    density += PLACE_SHARE[kind, c] * np.exp(e2 / s2) / (np.float32(2 * np.pi) * s2)
                place = min(np.log(density), np.float32(PLACE_MOST))
            limit = max(PLACE_LIMIT[min(kind, 2)], np.float32(NOISE_LIMIT) * (1 + np.float32(0.5) * kind) * noise)
            if claim[v, u] >= segmented:
                limit *= np.float32(RECOVERED_LIMIT)
            if kind < EXTRAPOLATED:
                # out of line with its surroundings: their own residuals tell how rough the surface is
                rough = np.float32(0)
                m = 0
                for vv in range(max(0, v - 1), min(rows, v + 2)):
                    for uu in range(max(0, u - 1), min(cols, u + 2)):
                        if claim[vv, uu] >= 0 and (vv != v or uu != u) and kind_of[vv, uu] < EXTRAPOLATED:
                            rough += error[vv, uu]
                            m += 1
                if m >= 4:
                    limit = min(limit, max(np.float32(smooth_limit) * (1 + kind), np.float32(ROUGHER) * rough / m))
            if kind < UNPREDICTED and error[v, u] > limit:
                place = np.float32(-OFF_PLACE)
            shape = thin_evidence(thin[v, u], thin_middle, thin_spread * THIN_KIND[kind])
            shape -= np.float32(2.0) * max(np.float32(0), abs(size[v, u]) - np.float32(0.25))
            own[v, u] = letter[v, u] + place + shape
            own[v, u] -= np.float32(LOST_WEIGHT) * max(np.float32(0), lost[v, u] / pixel - np.float32(LOST_FREE))
            if claim[v, u] >= segmented:
                own[v, u] += np.float32(RECOVERED)


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
def release_doubtful(claim, belief, kind_of, segmented, cut, asked, holder_u, holder_v):
    """Release held elements whose belief is below what is asked, and dots that are cut; returns how many are left.

    asked (2, 4) float32: log-odds per kind of prediction, of segmented dots and of those from number `segmented` on,
    which were recovered; cut (N,) bool of the segmented dots.
    """
    held = 0
    for v in range(claim.shape[0]):
        for u in range(claim.shape[1]):
            i = claim[v, u]
            if i < 0:
                continue
            recovered = i >= segmented
            if belief[v, u] < asked[np.int64(recovered), kind_of[v, u]] or (not recovered and cut[i]):
                holder_u[i] = -1
                holder_v[i] = -1
                claim[v, u] = -1
            else:
                held += 1
    return held


@compiled
def solve(claim, own, window, belief):
    """Beliefs (V, U): log-odds that each held element is right, own evidence and neighbours'.

    -20 where none is held.
    """
    rows, cols = claim.shape
    q = np.zeros((rows, cols), np.float32)
    half = (len(window) - 1) // 2
    for v in range(rows):
        for u in range(cols):
            belief[v, u] = -20.0
            if claim[v, u] >= 0:
                q[v, u] = np.tanh(0.5 * max(-4.0, min(4.0, own[v, u])))
    for _ in range(SWEEPS):
        moved = np.float32(0)
        for v in range(rows):
            for u in range(cols):
                if claim[v, u] < 0:
                    continue
                total = np.float32(0)
                for p in range(1, half + 1):
                    v1, u1 = v + window[p, 1], u + window[p, 0]
                    v2, u2 = v - window[p, 1], u - window[p, 0]
                    one = 0 <= v1 < rows and 0 <= u1 < cols and claim[v1, u1] >= 0
                    two = 0 <= v2 < rows and 0 <= u2 < cols and claim[v2, u2] >= 0
                    if one and two:
                        total += np.float32(PAIR) * min(q[v1, u1], q[v2, u2])
                    elif one:
                        total += np.float32(SINGLE) * q[v1, u1]
                    elif two:
                        total += np.float32(SINGLE) * q[v2, u2]
                belief[v, u] = own[v, u] + total
                # tanh(x / 2) by its rational approximation, good to 0.01
                x = max(np.float32(-8), min(np.float32(8), belief[v, u])) * np.float32(0.5)
                x2 = x * x
                t = x * (27 + x2) / (27 + 9 * x2)
                t = max(np.float32(-1), min(np.float32(1), t))
                moved = max(moved, abs(t - q[v, u]))
                q[v, u] = t
        if moved < np.float32(0.05):
            break
