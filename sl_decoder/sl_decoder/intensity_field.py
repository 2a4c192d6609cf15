"""Intensities relative to their surroundings: a field of albedo, distance and shading that neighbouring dots share.

The logarithm of a dot's signal is its letter's level plus the field; levels and field are estimated in turn. Loops run
over blocks of dots innermost, without branches: the compiler makes vectors of them.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.compiled import compiled
from sl_decoder.quantiles import quantile, sample

EDGE = 0.25  # log signal by which a neighbour may differ before it counts as beyond an albedo edge
RIDGE = 0.6  # damping of the field's slopes
NEIGHBOURS = 16  # nearest dots that tell a dot's field
BLOCK = 64  # dots whose fields are estimated at once
NONE = np.float32(1e9)  # in place of a log signal: no such neighbour, or none that counts
RING = 8  # nearest dots whose mean tells the first levels
ROUNDS = 3  # of letters, levels and field in turn


@compiled
def local_field(centre, signal, near, letter, level, use, field, field_variance):
    """Field (N,) at each dot: plane through its neighbours' log signals minus their letters' levels, and its variance.

    Robust (weights fall off with the distance from the median, so that albedo edges do not mix) and damped (a ridge on
    the slopes, so that one-sided neighbourhoods extrapolate a gradient without exaggerating it).
    """
    n = len(signal)
    own = np.empty(n, np.float32)
    value = np.full(n + 1, NONE, np.float32)  # the last is what the index -1 means: no neighbour
    for i in range(n):
        own[i] = signal[i] - level[letter[i]]
        value[i] = own[i] if use[i] else NONE
    neighbours = min(near.shape[1], NEIGHBOURS)
    around = np.zeros((3, neighbours, BLOCK), np.float32)
    number = np.zeros(BLOCK, np.int32)
    ordered = np.empty((neighbours, BLOCK), np.float32)
    middle = np.empty(BLOCK, np.float32)
    sums = np.empty((11, BLOCK), np.float32)
    for begin in range(0, n, BLOCK):
        _gather(centre, value, near, begin, around, number)
        ordered[:] = around[2]
        _medians(ordered, number, middle)
        _moments(around, middle, sums)
        plane, variance = sums[0], sums[1]
        _planes(sums, middle, plane, variance)
        for i in range(min(BLOCK, n - begin)):
            alone = number[i] == 0
            field[begin + i] = own[begin + i] if alone else plane[i]
            field_variance[begin + i] = np.float32(1) if alone else variance[i]


@compiled
def _gather(centre, value, near, begin, around, number):
    """Neighbours of a block of dots: around (3, K, BLOCK) their x and y from the dot [px] and value (NONE: not to
    count), number (BLOCK,) of those that count."""
    for i in range(min(BLOCK, len(near) - begin)):
        x, y = centre[begin + i, 0], centre[begin + i, 1]
        m = 0
        for q in range(around.shape[1]):
            j = near[begin + i, q]
            around[0, q, i] = centre[j, 0] - x
            around[1, q, i] = centre[j, 1] - y
            around[2, q, i] = value[j]
            m += np.int64(value[j] < NONE)
        number[i] = m


@compiled
def _medians(values, number, middle):
    """Upper median (BLOCK,) of the `number` (BLOCK,) least of each column of values (K, BLOCK), which are sorted."""
    for turn in range(len(values)):  # sorting by transposition: the same comparisons for all
        for q in range(turn & 1, len(values) - 1, 2):
            _sort_two(values[q], values[q + 1])
    for i in range(BLOCK):
        middle[i] = values[number[i] >> 1, i] if number[i] > 0 else np.float32(0)


@compiled
def _sort_two(low, high):
    for i in range(BLOCK):
        least = min(low[i], high[i])
        high[i] = max(low[i], high[i])
        low[i] = least


@compiled
def _moments(around, middle, sums):
    """Weighted sums (10, BLOCK) over the neighbours of 1, x, y, z, xx, xy, yy, xz, yz, zz; z: value from the median.

    Places are in units of the farthest neighbour's distance; sums[10] is work space.
    """
    one, zero = np.float32(1), np.float32(0)
    scale = sums[10]
    sums[:10] = zero
    scale[:] = one
    for q in range(around.shape[1]):
        x, y, value = around[0, q], around[1, q], around[2, q]
        for i in range(BLOCK):
            scale[i] = max(scale[i], x[i] * x[i] + y[i] * y[i] if value[i] < NONE else zero)
    for i in range(BLOCK):
        scale[i] = one / np.sqrt(scale[i])
    for q in range(around.shape[1]):
        _add_moments(around[0, q], around[1, q], around[2, q], scale, middle, sums)


@compiled
def _add_moments(xs, ys, value, scale, middle, sums):
    one, zero = np.float32(1), np.float32(0)
    for i in range(BLOCK):
        x = xs[i] * scale[i]
        y = ys[i] * scale[i]
        z = value[i] - middle[i]
        e = z * np.float32(1 / EDGE)
        w = one / (one + e * e) if value[i] < NONE else zero
        wx, wy, wz = w * x, w * y, w * z
        sums[0, i] += w
        sums[1, i] += wx
        sums[2, i] += wy
        sums[3, i] += wz
        sums[4, i] += wx * x
        sums[5, i] += wx * y
        sums[6, i] += wy * y
        sums[7, i] += wx * z
        sums[8, i] += wy * z
        sums[9, i] += wz * z


@compiled
def _planes(sums, middle, value, variance):
    """Value (BLOCK,) at the dots of the planes through their neighbours, and its variance; see `_moments`."""
    one, zero = np.float32(1), np.float32(0)
    for i in range(BLOCK):
        sw = max(sums[0, i], np.float32(1e-6))
        mx, my, mz = sums[1, i] / sw, sums[2, i] / sw, sums[3, i] / sw
        vxx = sums[4, i] - sw * mx * mx
        vyy = sums[6, i] - sw * my * my
        cxx = vxx + np.float32(RIDGE)
        cxy = sums[5, i] - sw * mx * my
        cyy = vyy + np.float32(RIDGE)
        cxz = sums[7, i] - sw * mx * mz
        cyz = sums[8, i] - sw * my * mz
        det = cxx * cyy - cxy * cxy
        gx = (cxz * cyy - cyz * cxy) / det
        gy = (cyz * cxx - cxz * cxy) / det
        # weighted sum of squared residuals, expanded
        slopes = gx * gx * vxx + 2 * gx * gy * cxy + gy * gy * vyy
        total = sums[9, i] - sw * mz * mz - 2 * (gx * cxz + gy * cyz) + slopes
        lever = one / sw + (mx * mx * cyy - 2 * mx * my * cxy + my * my * cxx) / det
        value[i] = middle[i] + mz - gx * mx - gy * my
        variance[i] = (max(total, zero) + np.float32(1e-4)) / sw * (np.float32(0.3) + lever)


@compiled
def _neighbour_sum(value, near, use, out):
    """Sum (N,) of value (N,) float32 over each dot's neighbours in use."""
    n = len(value)
    counted = np.zeros(n + 1, np.float32)  # the last is what the index -1 means: no neighbour
    for i in range(n):
        counted[i] = value[i] if use[i] else np.float32(0)
    for i in range(n):
        total = np.float32(0)
        for q in range(min(near.shape[1], RING)):
            total += counted[near[i, q]]
        out[i] = total


@compiled
def _neighbour_mean(value, near, use, number, out):
    """Mean (N,) of value (N,) over each dot's neighbours in use, which number (N,); 0 where there are none."""
    _neighbour_sum(value, near, use, out)
    for i in range(len(value)):
        out[i] /= max(number[i], np.float32(1))


@compiled
def _nearest_level(value, group, letter_group, level, letter):
    """Letter (N,) of each dot's group whose level is nearest to the dot's value (N,)."""
    least = np.full(len(value), NONE, np.float32)
    for a in range(len(level)):
        of_group, here, this = letter_group[a], level[a], np.int32(a)
        for i in range(len(value)):
            d = abs(value[i] - here) if group[i] == of_group else NONE
            letter[i] = this if d < least[i] else letter[i]
            least[i] = min(d, least[i])


@compiled
def first_levels(signal, group, near, use, letter_group, ranked, share, groups, level, letter, field):
    """Split each hue group into its intensities.

    Deviations from the local mean are ranked and cut in the map's shares, then letters, levels and field are iterated.
    ranked (A,) letters, darkest first; writes level (A,), letter (N,); field (N,): work space.
    """
    n = len(signal)
    count = len(level)
    chosen = sample(use, count)
    pool = np.empty(len(chosen), np.float32)
    number = np.empty(n, np.float32)
    _neighbour_sum(np.ones(n, np.float32), near, use, number)
    middle = np.zeros(groups, np.float32)
    for g in range(groups):
        m = 0
        for i in chosen:
            pool[m] = signal[i]
            m += np.int64(group[i] == g)
        middle[g] = quantile(pool[:m], 0.5)
    relative = np.empty(n, np.float32)
    for i in range(n):
        relative[i] = signal[i] - middle[group[i]]
    _neighbour_mean(relative, near, use, number, field)
    for g in range(groups):
        m = 0
        for i in chosen:
            pool[m] = signal[i] - field[i]
            m += np.int64(group[i] == g)
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
    sums = np.empty(count)
    members = np.empty(count, np.int64)
    for turn in range(ROUNDS):
        if turn > 0:
            for i in range(n):
                relative[i] = signal[i] - level[letter[i]]
            _neighbour_mean(relative, near, use, number, field)
        for i in range(n):
            relative[i] = signal[i] - field[i]
        _nearest_level(relative, group, letter_group, level, letter)
        sums[:] = 0
        members[:] = 0
        for i in chosen:
            sums[letter[i]] += relative[i]
            members[letter[i]] += 1
        for a in range(count):
            if members[a] >= 3:
                level[a] = sums[a] / members[a]
