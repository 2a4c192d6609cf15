"""Footprints of dots beside those of their neighbours: whole, thin, or with a part lost.

An edge, a dark patch or another dot that hides a part of a dot makes it thin and displaces its centre.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.approximation import exponential, logarithm
from sl_decoder.compiled import compiled
from sl_decoder.growth import FULL

# thinness: log of the smallest axis of a dot's footprint over its neighbours' mean footprint
THIN_STEP, THIN_LEAST, THIN_BINS = 0.02, -2.0, 150  # histogram of the whole rings' footprints
THIN_FLOOR = 0.08  # least spread
THIN_TAIL = 0.04  # share of true dots of any shape (highlights, noise)
THIN_RANGE = 2.0  # over which those, and dots that are cut, are spread
CUT_SHARE = 0.5  # of the false dots are cut by an edge, the others are whole dots of another surface
CORE_WIDTH = 2.0  # half the width of a core in standard deviations along it: of what is cut off, half is displacement
LOST_SHARE = 0.15  # of a dot's own width, which shading and curvature explain
UNKNOWN_SHARE = 0.7  # of the displacement of a dot whose shape is not known, that a lost part explains


@compiled
def thinness(c0, c1, c2, n0, n1, n2):
    """Logarithm of the smallest axis (as a variance) of footprint c in units of footprint n; cut in half: -1.3.

    Both are covariances xx, xy, yy [px^2]: the smaller eigenvalue of n^-1 c."""
    det = max(n0 * n2 - n1 * n1, np.float32(1e-6))
    half = np.float32(0.5) * (c0 * n2 - 2 * c1 * n1 + c2 * n0) / det
    product = (c0 * c2 - c1 * c1) / det
    return logarithm(max(half - np.sqrt(max(half * half - product, np.float32(0))), np.float32(0.05)))


@compiled
def thin_statistics(held, thin, kind):
    """Median and robust spread of the dots' thinness in this image, from those with whole rings; arrays (L,)."""
    histogram = np.zeros(THIN_BINS, np.int32)
    n = 0
    for k in range(len(thin)):
        if held[k] > 0 and kind[k] == FULL and thin[k] == thin[k]:
            step = int((thin[k] - np.float32(THIN_LEAST)) * np.float32(1 / THIN_STEP))
            histogram[max(0, min(THIN_BINS - 1, step))] += 1
            n += 1
    if n < 20:
        return np.float32(-0.1), np.float32(0.2)
    quarters = np.zeros(3, np.float32)
    below = 0
    q = 0
    for k in range(THIN_BINS):
        below += histogram[k]
        while q < 3 and 4 * below >= (q + 1) * n:
            quarters[q] = THIN_LEAST + (k + 0.5) * THIN_STEP
            q += 1
    # the upper half: dots that are cut belong to the lower
    spread = max((quarters[2] - quarters[1]) / np.float32(0.6745), np.float32(THIN_FLOOR))
    return quarters[1], spread


@compiled
def thin_evidence(thin, middle, spread):
    """Log-likelihood ratio of a footprint: true dots look like their neighbours, false ones are often cut."""
    z = (thin - middle) / spread
    z = z * np.float32(0.5) if z > 0 else z  # being fatter than the others is no sign of a cut
    like = exponential(np.float32(-0.5) * z * z) / (np.float32(2.5066) * spread)
    tail = np.float32(1 / THIN_RANGE)
    true = np.float32(1 - THIN_TAIL) * like + np.float32(THIN_TAIL) * tail
    false = np.float32(1 - CUT_SHARE) * like + np.float32(CUT_SHARE) * tail
    ratio = logarithm(true / false)
    return ratio if thin == thin else np.float32(0)


@compiled
def extent(c0, c1, c2, x, y):
    """Standard deviation [px] of the footprint c along the unit vector (x, y)."""
    return np.sqrt(max(c0 * x * x + 2 * c1 * x * y + c2 * y * y, np.float32(0.02)))


@compiled
def lost_beside(c0, c1, c2, n0, n1, n2, dx, dy, shapeless):
    """How far [px] the centre of footprint c is displaced by the loss of a part of the dot, as place and shape say.

    A dot of which a part is missing (cut by an edge, hidden, split) is narrower along the direction in which it is
    displaced, by twice the displacement. (dx, dy): off its prediction [px]; n: the neighbours' mean footprint;
    shapeless: c was not measured, and the displacement alone tells.
    """
    shift = np.sqrt(dx * dx + dy * dy)
    scale = np.float32(1) / max(shift, np.float32(1e-3))
    whole = extent(n0, n1, n2, dx * scale, dy * scale)
    here = extent(c0, c1, c2, dx * scale, dy * scale)
    narrower = np.float32(UNKNOWN_SHARE) * shift if shapeless else np.float32(CORE_WIDTH) * (whole - here)
    lost = min(shift, narrower) - np.float32(LOST_SHARE) * whole
    return max(lost, np.float32(0))


@compiled
def lost_at_line_end(claim, centre, covariance, v, u, steps):
    """The same for a held element at which a line of dots ends, from its last dots: all of a rim may be cut alike."""
    rows, cols = claim.shape
    i = claim[v, u]
    c0, c1, c2 = covariance[i, 0], covariance[i, 1], covariance[i, 2]
    lost = np.float32(0)
    for d in range(len(steps)):
        dv, du = steps[d, 1], steps[d, 0]
        if not (0 <= v - 2 * dv < rows and 0 <= u - 2 * du < cols):
            continue
        if 0 <= v + dv < rows and 0 <= u + du < cols and claim[v + dv, u + du] >= 0:
            continue
        p, q = claim[v - dv, u - du], claim[v - 2 * dv, u - 2 * du]
        if p < 0 or q < 0:
            continue
        x, y = centre[p, 0] - centre[q, 0], centre[p, 1] - centre[q, 1]
        length = max(np.sqrt(x * x + y * y), np.float32(1e-3))
        x, y = x / length, y / length
        short = (centre[p, 0] - centre[i, 0]) * x + (centre[p, 1] - centre[i, 1]) * y + length
        whole = extent(covariance[p, 0], covariance[p, 1], covariance[p, 2], x, y)
        if 0 <= v - 3 * dv < rows and 0 <= u - 3 * du < cols and claim[v - 3 * dv, u - 3 * du] >= 0:
            r = claim[v - 3 * dv, u - 3 * du]
            # half way to the parabola: the line bends, but the bend is noisy; the dots narrow with their distances
            before = (centre[q, 0] - centre[r, 0]) * x + (centre[q, 1] - centre[r, 1]) * y
            short += np.float32(0.5) * (length - before)
            before = extent(covariance[q, 0], covariance[q, 1], covariance[q, 2], x, y)
            whole = max(np.float32(1.5) * whole - np.float32(0.5) * before, np.float32(0.5) * whole)
        here = min(short, CORE_WIDTH * (whole - extent(c0, c1, c2, x, y))) - np.float32(LOST_SHARE) * whole
        lost = max(lost, here)
    return max(lost, np.float32(0))
