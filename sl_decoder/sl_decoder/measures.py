"""Measures of the held elements beside their neighbours: place, size and footprint.

All elements are measured at once, in arrays over the map with a rim of one element around it, flattened: whatever the
shape of the map, an element's neighbours are at the same distances along them, and loops become vector code.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sl_decoder.approximation import logarithm
from sl_decoder.compiled import compiled
from sl_decoder.footprints import lost_at_line_end, lost_beside, thinness
from sl_decoder.growth import FULL, UNPREDICTED, predict


class Measures(NamedTuple):
    """What is known of each element by itself, arrays (L,) float32 of the map with its rim; see `index_of`.

    held: one, or zero of an element that is not; letter: log-likelihood ratio of its letter; error: of its position
    [lattice units], at most one; kind: of the prediction; size: log of the core's area per lattice cell, relative to
    the neighbours'; thin, lost: see `thinness` (nan where there are too few neighbours) and `lost_beside` in
    footprints.py.
    """

    held: np.ndarray
    letter: np.ndarray
    error: np.ndarray
    kind: np.ndarray
    size: np.ndarray
    thin: np.ndarray
    lost: np.ndarray


@compiled
def index_of(v, u, cols):
    """Where the element (v, u) of a map with so many columns is in arrays with a rim."""
    return (v + 1) * (cols + 2) + u + 1


@compiled
def measure(claim, segmented, centre, area, covariance, log_p, map_letters, steps):
    """Measures of all held elements. claim (V, U); the others as in `Interpretation`.

    Dots from number `segmented` on were recovered: their shape is not their own, so that nothing but their
    displacement tells whether a part is lost.
    """
    rows, cols = claim.shape
    room = (rows + 2) * (cols + 2)
    m = Measures(
        np.zeros(room, np.float32),
        np.zeros(room, np.float32),
        np.empty(room, np.float32),
        np.full(room, np.float32(UNPREDICTED)),
        np.empty(room, np.float32),
        np.empty(room, np.float32),
        np.empty(room, np.float32),
    )
    place = np.zeros((2, room), np.float32)
    core = np.ones(room, np.float32)
    shape = np.zeros((3, room), np.float32)
    shapeless = np.zeros(room, np.bool_)
    for v in range(rows):
        for u in range(cols):
            i = claim[v, u]
            if i < 0:
                continue
            k = index_of(v, u, cols)
            m.held[k] = 1
            m.letter[k] = log_p[i, map_letters[v, u]]
            place[0, k], place[1, k] = centre[i, 0], centre[i, 1]
            core[k] = area[i]
            shapeless[k] = i >= segmented
            shape[0, k], shape[1, k], shape[2, k] = covariance[i, 0], covariance[i, 1], covariance[i, 2]
    off, basis = _predictions(claim, centre, steps, m, place)
    density = np.empty(room, np.float32)
    _errors(off, basis, core, m.kind, m.error, density)
    _compare(m, cols + 2, off, density, shape, shapeless)
    for v in range(rows):
        for u in range(cols):
            k = index_of(v, u, cols)
            if m.held[k] > 0 and m.kind[k] != FULL:
                m.lost[k] = max(m.lost[k], lost_at_line_end(claim, centre, covariance, v, u, steps))
    return m


@compiled
def _predictions(claim, centre, steps, m, place):
    """Where the held elements are, off (2, L) their predictions [px], and the lattice's basis (4, L) there: ax, ay, bx,
    by [px]; writes their kind."""
    rows, cols = claim.shape
    room = len(m.held)
    number = np.zeros(room, np.float32)
    off = np.zeros((2, room), np.float32)
    basis = np.ones((4, room), np.float32)
    if len(steps) == 4:
        around_sum(m.held, cols + 2, number)
        for c in range(2):
            _whole_rings(place[c], cols + 2, off[c], basis[c], basis[2 + c])
    for v in range(rows):
        for u in range(cols):
            i = claim[v, u]
            k = index_of(v, u, cols)
            if i < 0:
                continue
            if number[k] == 8:
                m.kind[k] = FULL
                continue
            x, y, kind, basis[0, k], basis[1, k], basis[2, k], basis[3, k] = predict(claim, centre, v, u, steps)
            m.kind[k] = kind
            off[0, k], off[1, k] = centre[i, 0] - x, centre[i, 1] - y
    return off, basis


@compiled
def around_sum(value, width, out):
    """Sums (L,) of value (L,) over the eight elements around each, in rows of so many."""
    n = len(value) - 2 * width
    up, here, down, to = value[:n], value[width : width + n], value[2 * width :], out[width : width + n]
    for i in range(1, n - 1):
        to[i] = up[i - 1] + up[i] + up[i + 1] + here[i - 1] + here[i + 1] + down[i - 1] + down[i] + down[i + 1]


@compiled
def _whole_rings(place, width, off, a, b):
    """One coordinate's offset from the prediction by the elements around, and of the basis; see `growth.predict`."""
    half, quarter, sixth = np.float32(0.5), np.float32(0.25), np.float32(1 / 6)
    n = len(place) - 2 * width
    up, here, down = place[:n], place[width : width + n], place[2 * width :]
    to, to_a, to_b = off[width : width + n], a[width : width + n], b[width : width + n]
    for i in range(1, n - 1):
        left = up[i - 1] + here[i - 1] + down[i - 1]
        right = up[i + 1] + here[i + 1] + down[i + 1]
        above = up[i - 1] + up[i] + up[i + 1]
        below = down[i - 1] + down[i] + down[i + 1]
        near = up[i] + here[i - 1] + here[i + 1] + down[i]
        corners = up[i - 1] + up[i + 1] + down[i - 1] + down[i + 1]
        to[i] = here[i] - (half * near - quarter * corners)
        to_a[i] = sixth * (right - left)
        to_b[i] = sixth * (below - above)


@compiled
def _errors(off, basis, core, kind, error, density):
    """Errors (L,) [lattice units], at most one, and the core's area per lattice cell (L,), logarithm; nan for none."""
    one, nan = np.float32(1), np.float32(np.nan)
    for i in range(len(error)):
        ax, ay, bx, by = basis[0, i], basis[1, i], basis[2, i], basis[3, i]
        det = ax * by - ay * bx
        s = off[0, i] * by - off[1, i] * bx
        t = ax * off[1, i] - ay * off[0, i]
        sound = kind[i] != UNPREDICTED and det > np.float32(1e-3)
        error[i] = min(np.sqrt(s * s + t * t) / max(det, np.float32(1e-3)), one) if sound else one
        density[i] = logarithm(core[i] / max(det, np.float32(1e-3))) if sound else nan


@compiled
def _compare(m, width, off, density, shape, shapeless):
    """Size, thinness and lost part of all elements beside those around them."""
    room = len(density)
    known, number, total = np.empty(room, np.float32), np.zeros(room, np.float32), np.zeros(room, np.float32)
    others = np.zeros((3, room), np.float32)
    value = np.empty(room, np.float32)
    for i in range(room):
        sound = m.held[i] > 0 and density[i] == density[i]
        known[i] = np.float32(sound)
        value[i] = density[i] if sound else np.float32(0)
    around_sum(known, width, number)
    around_sum(value, width, total)
    for i in range(room):
        sound = known[i] * number[i] > 0
        m.size[i] = value[i] - total[i] / max(number[i], np.float32(1)) if sound else np.float32(0)
    around_sum(m.held, width, number)
    for c in range(3):
        around_sum(shape[c], width, others[c])
    for i in range(room):
        scale = np.float32(1) / max(number[i], np.float32(1))
        n0, n1, n2 = others[0, i] * scale, others[1, i] * scale, others[2, i] * scale
        thin = thinness(shape[0, i], shape[1, i], shape[2, i], n0, n1, n2)
        m.thin[i] = thin if number[i] >= 2 else np.float32(np.nan)
    for i in range(room):
        scale = np.float32(1) / max(number[i], np.float32(1))
        n0, n1, n2 = others[0, i] * scale, others[1, i] * scale, others[2, i] * scale
        lost = lost_beside(shape[0, i], shape[1, i], shape[2, i], n0, n1, n2, off[0, i], off[1, i], shapeless[i])
        m.lost[i] = lost if number[i] >= 2 else np.float32(0)
