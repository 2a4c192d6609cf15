"""Intensities relative to their surroundings: a field of albedo, distance and shading that neighbouring dots share.

The logarithm of a dot's signal is its letter's level plus the field; levels and field are estimated in turn.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.compiled import compiled

EDGE = 0.25  # log signal by which a neighbour may differ before it counts as beyond an albedo edge
RIDGE = 0.6  # damping of the field's slopes
LANES = 16  # most neighbours of a dot that count; loops of constant length become vector code


@compiled
def select(values, rank):
    """The value that would stand at `rank` if values (N,) were sorted; reorders them (Hoare's selection)."""
    low, high = 0, len(values) - 1
    while low < high:
        pivot = values[(low + high) >> 1]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if rank <= j:
            high = j
        elif rank >= i:
            low = i
        else:
            break
    return values[rank]


@compiled
def quantile(values, share):
    """Quantile of values (N,) float32, which are reordered; 0 for none."""
    n = len(values)
    if n == 0:
        return np.float32(0)
    return select(values, min(n - 1, int(share * n)))


@compiled
def local_field(centre, signal, near, letter, level, use, field, field_variance):
    """Field (N,) at each dot: plane through its neighbours' log signals minus their letters' levels, and its variance.

    Robust (weights fall off with the distance from the median, so that albedo edges do not mix) and damped (a ridge on
    the slopes, so that one-sided neighbourhoods extrapolate a gradient without exaggerating it).
    """
    n, k = len(near), min(near.shape[1], LANES)
    one, zero = np.float32(1), np.float32(0)
    own = np.empty(n, np.float32)
    for i in range(n):
        own[i] = signal[i] - level[letter[i]]
    values = np.empty(LANES, np.float32)
    xs = np.empty(LANES, np.float32)
    ys = np.empty(LANES, np.float32)
    for i in range(n):
        m = 0
        far = one
        px, py = centre[i, 0], centre[i, 1]
        for q in range(k):
            j = near[i, q]
            if j < 0:
                break
            values[m] = own[j]
            x = centre[j, 0] - px
            y = centre[j, 1] - py
            xs[m] = x
            ys[m] = y
            if use[j]:
                far = max(far, x * x + y * y)
                m += 1
        if m == 0:
            field[i] = own[i]
            field_variance[i] = one
            continue
        for q in range(m, LANES):
            values[q] = np.float32(1e9)
        middle = _upper_median(values, m)
        scale = one / np.sqrt(far)
        sw = sz = sx = sy = sxx = sxy = syy = sxz = syz = szz = zero
        for q in range(m):
            z = values[q] - middle
            e = z * np.float32(1 / EDGE)
            w = one / (one + e * e)
            x = xs[q] * scale
            y = ys[q] * scale
            wx, wy, wz = w * x, w * y, w * z
            sw += w
            sz += wz
            sx += wx
            sy += wy
            sxx += wx * x
            sxy += wx * y
            syy += wy * y
            sxz += wx * z
            syz += wy * z
            szz += wz * z
        mx = sx / sw
        my = sy / sw
        mz = sz / sw
        vxx = sxx - sw * mx * mx
        vyy = syy - sw * my * my
        cxx = vxx + np.float32(RIDGE)
        cxy = sxy - sw * mx * my
        cyy = vyy + np.float32(RIDGE)
        cxz = sxz - sw * mx * mz
        cyz = syz - sw * my * mz
        det = cxx * cyy - cxy * cxy
        gx = (cxz * cyy - cyz * cxy) / det
        gy = (cyz * cxx - cxz * cxy) / det
        field[i] = middle + mz - gx * mx - gy * my
        # weighted sum of squared residuals, expanded
        total = szz - sw * mz * mz - 2 * (gx * cxz + gy * cyz) + gx * gx * vxx + 2 * gx * gy * cxy + gy * gy * vyy
        lever = one / sw + (mx * mx * cyy - 2 * mx * my * cxy + my * my * cxx) / det
        field_variance[i] = (max(total, zero) + np.float32(1e-4)) / sw * (np.float32(0.3) + lever)


@compiled
def _upper_median(values, n):
    """Value of rank n // 2 of the first n of LANES values; the others must be greater.

    Counting compares all pairs, without a branch that depends on them: faster than sorting sixteen.
    """
    middle = values[0]
    for i in range(LANES):
        below = np.int32(0)
        up_to = np.int32(0)
        for j in range(LANES):
            below += np.int32(values[j] < values[i])
            up_to += np.int32(values[j] <= values[i])
        middle = values[i] if below <= n >> 1 < up_to else middle
    return middle


@compiled
def _neighbour_mean(values, near, use, out):
    for i in range(len(values)):
        total = np.float32(0)
        m = 0
        for q in range(near.shape[1]):
            j = near[i, q]
            if j < 0:
                break
            if use[j]:
                total += values[j]
                m += 1
        out[i] = total / m if m > 0 else values[i]


@compiled
def first_levels(signal, group, near, use, letter_group, ranked, share, groups, level, letter, field):
    """Split each hue group into its intensities.

    Deviations from the local mean are ranked and cut in the map's shares, then assignment, levels and field are
    iterated. ranked (A,) letters, darkest first; writes level (A,), letter (N,), field (N,).
    """
    n = len(signal)
    count = len(level)
    middle = np.zeros(groups, np.float32)
    pool = np.empty(n, np.float32)
    for g in range(groups):
        m = 0
        for i in range(n):
            if use[i] and group[i] == g:
                pool[m] = signal[i]
                m += 1
        middle[g] = quantile(pool[:m], 0.5)
    relative = np.empty(n, np.float32)
    for i in range(n):
        relative[i] = signal[i] - middle[group[i]]
    _neighbour_mean(relative, near, use, field)
    for g in range(groups):
        m = 0
        for i in range(n):
            if use[i] and group[i] == g:
                pool[m] = signal[i] - field[i]
                m += 1
        total = 0.0
        for a in range(count):
            if letter_group[a] == g:
                total += share[a]
        low = 0.0
        for r in range(count):
            a = ranked[r]
            if letter_group[a] != g:
                continue
            high = low + share[a] / max(total, 1e-9)
            level[a] = quantile(pool[:m], 0.5 * (low + high))
            low = high
    sums = np.zeros(count)
    number = np.zeros(count, np.int64)
    for _ in range(3):
        sums[:] = 0
        number[:] = 0
        for i in range(n):
            best = np.float32(1e30)
            for a in range(count):
                if letter_group[a] == group[i]:
                    d = abs(signal[i] - field[i] - level[a])
                    if d < best:
                        best = d
                        letter[i] = a
            if use[i]:
                sums[letter[i]] += signal[i] - field[i]
                number[letter[i]] += 1
        for a in range(count):
            if number[a] >= 3:
                level[a] = sums[a] / number[a]
        for i in range(n):
            relative[i] = signal[i] - level[letter[i]]
        _neighbour_mean(relative, near, use, field)
