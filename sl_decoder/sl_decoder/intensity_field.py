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


@compiled
def quantile(values, share):
    """Quantile of values (N,) float32 that are sorted in place; 0 for none."""
    n = len(values)
    if n == 0:
        return np.float32(0)
    values.sort()
    return values[min(n - 1, int(share * n))]


@compiled
def local_field(centre, signal, near, letter, level, use, field, field_variance):
    """Field (N,) at each dot: plane through its neighbours' log signals minus their letters' levels, and its variance.

    Robust (weights fall off with the distance from the median, so that albedo edges do not mix) and damped (a ridge on
    the slopes, so that one-sided neighbourhoods extrapolate a gradient without exaggerating it).
    """
    n, k = near.shape
    values = np.empty(k, np.float32)
    ordered = np.empty(k, np.float32)
    xs = np.empty(k, np.float32)
    ys = np.empty(k, np.float32)
    one = np.float32(1)
    for i in range(n):
        m = 0
        far = np.float32(0)
        for q in range(k):
            j = near[i, q]
            if j < 0:
                break
            if not use[j]:
                continue
            value = signal[j] - level[letter[j]]
            values[m] = value
            xs[m] = centre[j, 0] - centre[i, 0]
            ys[m] = centre[j, 1] - centre[i, 1]
            far = max(far, xs[m] * xs[m] + ys[m] * ys[m])
            p = m
            while p > 0 and ordered[p - 1] > value:
                ordered[p] = ordered[p - 1]
                p -= 1
            ordered[p] = value
            m += 1
        if m == 0:
            field[i] = signal[i] - level[letter[i]]
            field_variance[i] = one
            continue
        middle = ordered[m // 2]
        scale = one / np.sqrt(max(far, one))
        sw = sz = sx = sy = sxx = sxy = syy = sxz = syz = np.float32(0)
        for q in range(m):
            z = values[q] - middle
            w = one / (one + (z / np.float32(EDGE)) ** 2)
            x = xs[q] * scale
            y = ys[q] * scale
            sw += w
            sz += w * z
            sx += w * x
            sy += w * y
            sxx += w * x * x
            sxy += w * x * y
            syy += w * y * y
            sxz += w * x * z
            syz += w * y * z
        mx = sx / sw
        my = sy / sw
        mz = sz / sw
        cxx = sxx - sw * mx * mx + np.float32(RIDGE)
        cxy = sxy - sw * mx * my
        cyy = syy - sw * my * my + np.float32(RIDGE)
        cxz = sxz - sw * mx * mz
        cyz = syz - sw * my * mz
        det = cxx * cyy - cxy * cxy
        gx = (cxz * cyy - cyz * cxy) / det
        gy = (cyz * cxx - cxz * cxy) / det
        field[i] = middle + mz - gx * mx - gy * my
        total = np.float32(0)
        for q in range(m):
            z = values[q] - middle
            w = one / (one + (z / np.float32(EDGE)) ** 2)
            r = z - mz - gx * (xs[q] * scale - mx) - gy * (ys[q] * scale - my)
            total += w * r * r
        lever = one / sw + (mx * mx * cyy - 2 * mx * my * cxy + my * my * cxx) / det
        field_variance[i] = (total + np.float32(1e-4)) / sw * (np.float32(0.3) + lever)


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
        values = pool[:m]
        values.sort()
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
            level[a] = values[min(m - 1, int(0.5 * (low + high) * m))] if m > 0 else np.float32(0)
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
