"""Recovery: dots that were not segmented, measured where the decoded lattice expects them.

Faint dots below the threshold of segmentation, and dots that merged with a neighbour, are looked for at their predicted
places with their expected shape and colour. What is found is claimed like any other dot and judged with the rest.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.compiled import compiled
from sl_decoder.growth import EXTRAPOLATED, UNPREDICTED, lattice_error, predict
from sl_decoder.letter_model import evidence_of_one, mixtures, neighbours_field, projected_signal
from sl_decoder.matched import FOUND, measure_at, workspace

REACH = 0.3  # search radius around the prediction, lattice units
OFFSET_SAMPLES = 100  # dots that are measured both ways to find how the two ways differ
UNKNOWN_OFFSET = np.float32(np.nan)
SEARCHED = np.float32(np.inf)  # nothing under the prediction is taken without a look around it
APART = 0.5  # a recovered dot keeps this distance from all held ones, lattice units


@compiled
def _mean_footprint(claim, v, u, covariance, area, window):
    """Mean covariance (xx, xy, yy) and area of the held neighbours of the map's element (u, v)."""
    rows, cols = claim.shape
    cxx = cxy = cyy = size = np.float32(0)
    m = np.float32(0)
    for p in range(1, len(window)):
        vv, uu = v + window[p, 1], u + window[p, 0]
        if 0 <= vv < rows and 0 <= uu < cols and claim[vv, uu] >= 0:
            j = claim[vv, uu]
            cxx += covariance[j, 0]
            cxy += covariance[j, 1]
            cyy += covariance[j, 2]
            size += np.float32(area[j])
            m += np.float32(1)
    return cxx / m, cxy / m, cyy / m, size / m


@compiled
def matched_offset(claim, smooth, centre, covariance, signal, map_letters, steps, model, circle):
    """Median difference of the log signal as `measure_at` measures it from that of the segmented dots."""
    rows, cols = claim.shape
    values = np.empty(OFFSET_SAMPLES, np.float32)
    found = np.empty(FOUND, np.float32)
    work = workspace()
    mixes = mixtures(model.direction)
    n = 0
    held = 0
    for v in range(rows):
        for u in range(cols):
            held += claim[v, u] >= 0
    stride = max(1, held // OFFSET_SAMPLES)
    count = 0
    for v in range(rows):
        for u in range(cols):
            i = claim[v, u]
            if i < 0:
                continue
            count += 1
            if count % stride or n >= OFFSET_SAMPLES:
                continue
            _, _, kind, ax, ay, bx, by = predict(claim, centre, v, u, steps)
            if kind >= EXTRAPOLATED:
                continue
            g = model.group[map_letters[v, u]]
            if measure_at(
                smooth,
                centre[i, 0],
                centre[i, 1],
                covariance[i, 0],
                covariance[i, 1],
                covariance[i, 2],
                mixes[g],
                ax,
                ay,
                bx,
                by,
                np.float32(0.2),
                np.float32(0),
                circle,
                work,
                found,
            ):
                values[n] = projected_signal(found[2], found[3], found[4], model.direction[g]) - signal[i]
                n += 1
    return np.float32(np.median(values[:n])) if n > 0 else np.float32(0)


@compiled
def recover(
    claim,
    holder_u,
    holder_v,
    tried,
    n,
    smooth,
    centre,
    colour,
    covariance,
    area,
    noise,
    saturated,
    signal,
    log_p,
    letter,
    map_letters,
    steps,
    window,
    model,
    level_offset,
    circle,
    reach,
    least,
):
    """Look for the dots of all free elements next to held ones, outwards until nothing more is found.

    Writes new dots behind the first `n` of the per-dot arrays (as long as there is room) and claims them. tried (V, U)
    bool: elements not to look at again. level_offset: see `matched_offset`, nan: found here when there is any use for
    it. Returns the new number of dots.
    """
    rows, cols = claim.shape
    capacity = len(holder_u)
    queue = np.empty((rows * cols, 2), np.int32)
    waiting = np.zeros((rows, cols), np.bool_)
    tail = 0
    head = 0
    found = np.empty(FOUND, np.float32)
    work = workspace()
    mixes = mixtures(model.direction)
    for v in range(rows):
        for u in range(cols):
            if claim[v, u] >= 0 or map_letters[v, u] < 0 or tried[v, u]:
                continue
            for d in range(len(steps)):
                vv, uu = v + steps[d, 1], u + steps[d, 0]
                if 0 <= vv < rows and 0 <= uu < cols and claim[vv, uu] >= 0:
                    queue[tail, 0], queue[tail, 1] = v, u
                    waiting[v, u] = True
                    tail += 1
                    break
    if tail > 0 and np.isnan(level_offset):
        level_offset = matched_offset(claim, smooth, centre, covariance, signal, map_letters, steps, model, circle)
    while head < tail and n < capacity:
        v, u = queue[head, 0], queue[head, 1]
        head += 1
        x, y, kind, ax, ay, bx, by = predict(claim, centre, v, u, steps)
        if kind == UNPREDICTED:
            waiting[v, u] = False
            continue
        field, variance, m = neighbours_field(claim, v, u, signal, model.level, map_letters, window)
        if m < 2:
            waiting[v, u] = False
            continue
        tried[v, u] = True
        cxx, cxy, cyy, size = _mean_footprint(claim, v, u, covariance, area, window)
        expected = map_letters[v, u]
        g = model.group[expected]
        if not measure_at(
            smooth, x, y, cxx, cxy, cyy, mixes[g], ax, ay, bx, by, np.float32(reach), SEARCHED, circle, work, found
        ):
            continue
        clear = True
        for p in range(1, len(window)):
            vv, uu = v + window[p, 1], u + window[p, 0]
            if 0 <= vv < rows and 0 <= uu < cols and claim[vv, uu] >= 0:
                j = claim[vv, uu]
                if lattice_error(found[0] - centre[j, 0], found[1] - centre[j, 1], ax, ay, bx, by) < APART:
                    clear = False
        if not clear:
            continue
        i = n
        s = projected_signal(found[2], found[3], found[4], model.direction[g]) - level_offset
        letter[i] = evidence_of_one(model, found[2:5], s, field, variance, found[9], log_p[i])
        if log_p[i, expected] < least:
            continue
        centre[i, 0], centre[i, 1] = found[0], found[1]
        colour[i, 0], colour[i, 1], colour[i, 2] = found[2], found[3], found[4]
        covariance[i, 0], covariance[i, 1], covariance[i, 2] = cxx, cxy, cyy
        area[i] = int(size)
        saturated[i] = found[5]
        noise[i] = found[9]
        signal[i] = s
        claim[v, u] = i
        holder_v[i], holder_u[i] = v, u
        n += 1
        for d in range(len(steps)):
            vv, uu = v + steps[d, 1], u + steps[d, 0]
            if (
                0 <= vv < rows
                and 0 <= uu < cols
                and claim[vv, uu] < 0
                and map_letters[vv, uu] >= 0
                and not tried[vv, uu]
                and not waiting[vv, uu]
                and tail < len(queue)
            ):
                queue[tail, 0], queue[tail, 1] = vv, uu
                waiting[vv, uu] = True
                tail += 1
    return n
