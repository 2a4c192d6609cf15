"""Following: dots measured around their predicted places, and weighed against their neighbours on the map."""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.compiled import compiled
from sl_decoder.growth import UNPREDICTED, predict
from sl_decoder.letter_model import letter_evidence, mixtures, neighbours_field, projected_signal
from sl_decoder.matched import FOUND, measure_at, workspace

STILL_LIT = 0.5  # share of its signal in the last image from which a dot under its prediction is taken for the same


@compiled
def follow(
    index,
    place,
    shape,
    before,
    every,
    claim,
    smooth,
    map_letters,
    steps,
    model,
    offset,
    circle,
    reach,
    centre,
    colour,
    covariance,
    noise,
    saturated,
    signal,
    holder_u,
    holder_v,
):
    """Measure the dots, of each `every` one, around their predicted places.

    index (V, U) int32: row of `place` (N, 2) predicted px and `shape` (N, 3) (footprint in lattice units) and
    `before` (N, 3) (B, G, R in the last image), or -1.
    Writes the per-dot arrays, claim (V, U) and the holders; returns the number of dots found. Covariances are measured
    under the weight, which bounds them, and scaled so that their mean is that of the footprints: as in a full decoding,
    dots that an edge cuts differ from their neighbours.
    """
    rows, cols = index.shape
    found = np.empty(FOUND, np.float32)
    work = workspace()
    mixes = mixtures(model.direction)
    n = 0
    expected = measured = np.float32(0)
    two = np.float32(2)
    for v in range(rows):
        for u in range(cols):
            claim[v, u] = -1
            i = index[v, u]
            if i < 0 or (every > 1 and i % every):
                continue
            _, _, kind, ax, ay, bx, by = predict(index, place, v, u, steps)
            if kind == UNPREDICTED:
                continue
            # footprint from lattice units to pixels: B K B^T
            kxx, kxy, kyy = shape[i, 0], shape[i, 1], shape[i, 2]
            cxx = ax * ax * kxx + two * ax * bx * kxy + bx * bx * kyy
            cxy = ax * ay * kxx + (ax * by + bx * ay) * kxy + bx * by * kyy
            cyy = ay * ay * kxx + two * ay * by * kxy + by * by * kyy
            g = model.group[map_letters[v, u]]
            px, py = place[i, 0], place[i, 1]
            mix = mixes[g]
            least = mix[0] * before[i, 0] + mix[1] * before[i, 1] + mix[2] * before[i, 2]
            least *= np.float32(STILL_LIT)
            if not measure_at(
                smooth, px, py, cxx, cxy, cyy, mix, ax, ay, bx, by, np.float32(reach), least, circle, work, found
            ):
                continue
            centre[n, 0], centre[n, 1] = found[0], found[1]
            colour[n, 0], colour[n, 1], colour[n, 2] = found[2], found[3], found[4]
            covariance[n, 0], covariance[n, 1], covariance[n, 2] = found[6], found[7], found[8]
            expected += cxx + cyy
            measured += found[6] + found[8]
            saturated[n] = found[5]
            noise[n] = found[9]
            signal[n] = projected_signal(found[2], found[3], found[4], model.direction[g]) - offset
            claim[v, u] = n
            holder_v[n], holder_u[n] = v, u
            n += 1
    covariance[:n] *= expected / max(measured, np.float32(1e-3))
    return n


@compiled
def weigh_on_map(claim, n, colour, signal, noise, map_letters, window, model, evidence, letter):
    """Letter evidence of the first n dots, all held, against the field of their neighbours on the map."""
    rows, cols = claim.shape
    field = np.empty(n, np.float32)
    variance = np.empty(n, np.float32)
    profile = np.full(n, np.nan, np.float32)
    for v in range(rows):
        for u in range(cols):
            i = claim[v, u]
            if i < 0:
                continue
            field[i], variance[i], m = neighbours_field(claim, v, u, signal, model.level, map_letters, window)
            if m == 0:
                field[i] = signal[i] - model.level[map_letters[v, u]]
    letter_evidence(model, colour[:n], profile, signal[:n], field, variance, noise[:n], evidence[:n], letter[:n])


@compiled
def remember(claim, centre, covariance, steps, shape, basis_known):
    """Footprints (V, U, 3) of the held dots in lattice units: B^-1 C B^-T."""
    rows, cols = claim.shape
    for v in range(rows):
        for u in range(cols):
            i = claim[v, u]
            basis_known[v, u] = False
            if i < 0:
                continue
            _, _, kind, ax, ay, bx, by = predict(claim, centre, v, u, steps)
            det = ax * by - ay * bx
            if kind == UNPREDICTED or det <= 1e-3:
                continue
            c0, c1, c2 = covariance[i, 0], covariance[i, 1], covariance[i, 2]
            p0, p1 = by / det, -bx / det
            q0, q1 = -ay / det, ax / det
            shape[v, u, 0] = p0 * p0 * c0 + 2 * p0 * p1 * c1 + p1 * p1 * c2
            shape[v, u, 1] = p0 * q0 * c0 + (p0 * q1 + p1 * q0) * c1 + p1 * q1 * c2
            shape[v, u, 2] = q0 * q0 * c0 + 2 * q0 * q1 * c1 + q1 * q1 * c2
            basis_known[v, u] = True
