"""The model of the letters in one image, its fit to dots of known letters, and the evidence it gives.

A letter has a hue group (a colour direction and, where the pattern has several shapes, a radial profile) and a level of
intensity above the field of its surroundings. Loops run over dots innermost, without branches: the compiler makes
vectors of them.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sl_decoder.alphabet import Alphabet
from sl_decoder.approximation import exponential, logarithm
from sl_decoder.compiled import compiled
from sl_decoder.intensity_field import quantile

OUTLIER = 0.04  # share of true dots that fit no hue, over that of false ones
HUE_FLOOR = 3e-4  # likelihood from which on a hue counts as none of the letters': four sigmas
LEVEL_RANGE = 4.0  # log signal over which intensities that do not follow the field are spread
FIRST_STRAY = 0.1  # share of such dots before anything is decoded
ANY_PROFILE = 1e3  # spread of the radial kurtosis where all letters have one shape: nothing to tell apart
BLOCK = 64  # dots that are weighed at once
MOST_LETTERS = 36  # as many digits as a row of a pattern file has


class LetterModel(NamedTuple):
    """Fitted to one image of a pattern with A letters in G groups of hue and shape.

    group (A,) int32 of each letter; per group: direction (G, 3) float32 unit colour, spread of the angle [rad], profile
    and profile_spread of the radial kurtosis; per letter: level (log signal relative to the field) and level_spread;
    stray: share of dots off the field. All floats are single precision.
    """

    group: np.ndarray
    direction: np.ndarray
    spread: np.ndarray
    profile: np.ndarray
    profile_spread: np.ndarray
    level: np.ndarray
    level_spread: np.ndarray
    stray: np.float32


@compiled
def letter_evidence(model, colour, profile, signal, field, field_variance, noise, out, letter):
    """Evidence for each letter of N dots: log-likelihood ratios against a dot that happens to lie there.

    colour (N, 3): B, G, R above the background; profile (N,): radial kurtosis, nan where not measured; signal (N,) log
    signal; field, field_variance (N,); noise (N,) of a channel; all float32. Writes out (N, A) and the best letter (N,)
    int32.

    Some true dots' intensity does not follow the field (next to albedo edges, in highlights: `stray`); their hue still
    counts. False dots stray half of the time. A dot that fits no hue speaks against every letter.
    """
    count = len(model.level)
    one, zero = np.float32(1), np.float32(0)
    broad = np.float32(1 / LEVEL_RANGE)
    stray = np.float32(model.stray)
    share = np.float32(0.5) / np.float32(count)
    # one array holds all that a block needs: the compiler then sees that its rows do not overlap
    w = np.empty((10 + MOST_LETTERS, BLOCK), np.float32)
    for begin in range(0, len(signal), BLOCK):
        m = min(BLOCK, len(signal) - begin)
        for i in range(m):
            j = begin + i
            w[0, i], w[1, i], w[2, i] = colour[j, 0], colour[j, 1], colour[j, 2]
            w[3, i] = profile[j]
            w[4, i] = signal[j] - field[j]
            w[5, i] = field_variance[j]
            w[6, i] = noise[j]
        for i in range(BLOCK):
            length = max(np.sqrt(w[0, i] * w[0, i] + w[1, i] * w[1, i] + w[2, i] * w[2, i]), np.float32(1e-6))
            w[0, i] /= length
            w[1, i] /= length
            w[2, i] /= length
            e = w[6, i] / length
            w[6, i] = e * e
            w[7, i] = -one  # best value so far
            w[8, i] = zero  # its letter
            w[9, i] = np.float32(HUE_FLOOR)  # likelihood of what is not a dot
        for k in range(count):
            g = model.group[k]
            d0, d1, d2 = model.direction[g, 0], model.direction[g, 1], model.direction[g, 2]
            angle_variance = model.spread[g] * model.spread[g]
            shape, shape_weight = model.profile[g], one / model.profile_spread[g]
            level = model.level[k]
            level_variance = model.level_spread[k] * model.level_spread[k]
            this = np.float32(k)
            row = w[10 + k]
            for i in range(BLOCK):
                d = w[0, i] * d0 + w[1, i] * d1 + w[2, i] * d2
                misfit = np.float32(2) * max(one - d, zero) / (angle_variance + w[6, i])
                z = (w[3, i] - shape) * shape_weight
                misfit += z * z if w[3, i] == w[3, i] else zero
                hue = exponential(np.float32(-0.5) * misfit)
                e = w[4, i] - level
                precision = one / np.sqrt(level_variance + w[6, i] + w[5, i])
                z = e * precision
                near = np.float32(0.39894) * precision * exponential(np.float32(-0.5) * z * z)
                w[9, i] += hue * share * (near + broad)
                v = hue * ((one - stray) * near + stray * broad)
                row[i] = v
                # where strays tie, the nearer level is the letter
                v += np.float32(1e-9) * hue * max(np.float32(64) - e * e, zero)
                w[8, i] = this if v > w[7, i] else w[8, i]
                w[7, i] = max(v, w[7, i])
        for k in range(count):
            row = w[10 + k]
            for i in range(BLOCK):
                row[i] = logarithm((row[i] + np.float32(OUTLIER * HUE_FLOOR)) / w[9, i])
        for i in range(m):
            letter[begin + i] = np.int32(w[8, i])
            for k in range(count):
                out[begin + i, k] = w[10 + k, i]


@compiled
def evidence_of_one(model, colour, signal, field, field_variance, noise, out):
    """`letter_evidence` of one dot, whose radial profile was not measured: writes out (A,), returns the best letter.

    colour (3,) float32; the other measures are float32 scalars.
    """
    scalars = np.empty((5, 1), np.float32)
    scalars[0, 0] = np.nan
    scalars[1, 0] = signal
    scalars[2, 0] = field
    scalars[3, 0] = field_variance
    scalars[4, 0] = noise
    letter = np.empty(1, np.int32)
    letter_evidence(
        model,
        colour.reshape((1, 3)),
        scalars[0],
        scalars[1],
        scalars[2],
        scalars[3],
        scalars[4],
        out.reshape((1, len(out))),
        letter,
    )
    return letter[0]


@compiled
def neighbours_field(claim, v, u, signal, level, map_letters, window):
    """Field of the log signal at the map's element (u, v), its variance, and how many held neighbours gave it."""
    rows, cols = claim.shape
    total = np.float32(0)
    square = np.float32(0)
    m = 0
    for p in range(1, len(window)):
        vv, uu = v + window[p, 1], u + window[p, 0]
        if 0 <= vv < rows and 0 <= uu < cols and claim[vv, uu] >= 0:
            value = signal[claim[vv, uu]] - level[map_letters[vv, uu]]
            total += value
            square += value * value
            m += 1
    if m == 0:
        return np.float32(0), np.float32(0.25), 0
    mean = total / m
    variance = max(square / m - mean * mean, np.float32(1e-3)) * (np.float32(0.5) + np.float32(1) / m)
    return mean, variance, m


@compiled
def projected_signal(blue, green, red, direction):
    """Logarithm of a colour's component along a unit colour direction (3,)."""
    value = blue * direction[0] + green * direction[1] + red * direction[2]
    return logarithm(max(np.float32(value), np.float32(0.5)))


@compiled
def log_signal(colour, direction, group):
    """Logarithm (N,) of each dot's signal along its group's colour direction."""
    out = np.empty(len(colour), np.float32)
    for i in range(len(colour)):
        out[i] = projected_signal(colour[i, 0], colour[i, 1], colour[i, 2], direction[group[i]])
    return out


@compiled
def mixtures(direction):
    """Share (G, 3) of the channels in each group's colour direction."""
    mix = np.empty((len(direction), 3), np.float32)
    for g in range(len(direction)):
        total = np.float32(0)
        for c in range(3):
            mix[g, c] = max(direction[g, c], np.float32(0))
            total += mix[g, c]
        for c in range(3):
            mix[g, c] /= total
    return mix


@compiled
def _middle_and_spread(pool, least, most):
    """Median of pool (N,) and its spread from the median absolute deviation, within [least, most]."""
    middle = quantile(pool, 0.5)
    for k in range(len(pool)):
        pool[k] = abs(pool[k] - middle)
    return middle, min(max(np.float32(1.48) * quantile(pool, 0.5), np.float32(least)), np.float32(most))


@compiled
def _fit_direction(unit, direction, pool):
    """Robust mean of unit colours (N, 3), in place of direction (3,); returns the spread of the angle.

    Two rounds, the second without outliers; fewer than five dots leave the direction as it is.
    """
    n = len(unit)
    spread = np.float32(0.15)
    for turn in range(2):
        t0 = t1 = t2 = np.float32(0)
        limit = np.float32(9) * spread * spread if turn == 1 else np.float32(8)
        for i in range(n):
            p, q, r = unit[i, 0], unit[i, 1], unit[i, 2]
            d = p * direction[0] + q * direction[1] + r * direction[2]
            w = np.float32(1) if np.float32(2) * (1 - d) <= limit else np.float32(0)
            t0 += w * p
            t1 += w * q
            t2 += w * r
        norm = np.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
        if norm < 5:
            break
        direction[0], direction[1], direction[2] = t0 / norm, t1 / norm, t2 / norm
        for i in range(n):
            d = unit[i, 0] * direction[0] + unit[i, 1] * direction[1] + unit[i, 2] * direction[2]
            pool[i] = np.float32(2) * max(1 - d, np.float32(0))
        spread = np.sqrt(quantile(pool[:n], 0.5) / np.float32(1.39))
        spread = min(max(spread, np.float32(0.02)), np.float32(0.5))
    return spread


@compiled
def _fit(model, colour, profile, signal, field, letter, use, several_shapes):
    """Fit the arrays of a model in place; returns the share of dots off the field."""
    n = len(signal)
    pool = np.empty(n, np.float32)
    unit = np.empty((n, 3), np.float32)
    for g in range(len(model.direction)):
        m = 0
        members = 0
        for i in range(n):
            if not use[i] or model.group[letter[i]] != g:
                continue
            pool[members] = profile[i]
            members += 1
            p, q, r = colour[i, 0], colour[i, 1], colour[i, 2]
            norm = np.sqrt(p * p + q * q + r * r)
            if norm <= 1:
                continue
            unit[m, 0], unit[m, 1], unit[m, 2] = p / norm, q / norm, r / norm
            m += 1
        if several_shapes and members >= 5:
            model.profile[g], model.profile_spread[g] = _middle_and_spread(pool[:members], 0.01, ANY_PROFILE)
        model.spread[g] = _fit_direction(unit[:m], model.direction[g], pool)
    for a in range(len(model.level)):
        m = 0
        for i in range(n):
            if use[i] and letter[i] == a:
                pool[m] = signal[i] - field[i]
                m += 1
        if m >= 5:
            model.level[a], model.level_spread[a] = _middle_and_spread(pool[:m], 0.03, 0.6)
    off = 0
    m = 0
    for i in range(n):
        if use[i]:
            m += 1
            a = letter[i]
            if abs(signal[i] - field[i] - model.level[a]) > 4 * model.level_spread[a] + np.float32(0.1):
                off += 1
    if m < 50:
        return FIRST_STRAY
    return min(max(1.2 * off / m, 0.02), 0.4)


def fit_model(
    alphabet: Alphabet,
    colour: np.ndarray,
    profile: np.ndarray,
    signal: np.ndarray,
    field: np.ndarray,
    letter: np.ndarray,
    use: np.ndarray,
    direction: np.ndarray,
    level: np.ndarray,
) -> LetterModel:
    """Directions, profiles, levels and their spreads from dots of (presumably) known letters."""
    groups = len(direction)
    model = LetterModel(
        group=alphabet.group,
        direction=direction.copy(),
        spread=np.full(groups, 0.15, np.float32),
        profile=np.zeros(groups, np.float32),
        profile_spread=np.full(groups, ANY_PROFILE, np.float32),
        level=level.copy(),
        level_spread=np.full(len(level), 0.2, np.float32),
        stray=np.float32(FIRST_STRAY),
    )
    several = len(alphabet.profiles) > 1
    return model._replace(stray=np.float32(_fit(model, colour, profile, signal, field, letter, use, several)))
