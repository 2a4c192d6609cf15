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
from sl_decoder.quantiles import quantile, sample

OUTLIER = 0.04  # share of true dots that fit no hue, over that of false ones
HUE_FLOOR = 3e-4  # likelihood from which on a hue counts as none of the letters': four sigmas
LEVEL_RANGE = 4.0  # log signal over which intensities that do not follow the field are spread
FIRST_STRAY = 0.1  # share of such dots before anything is decoded
ANY_PROFILE = 1e3  # spread of the radial kurtosis where all letters have one shape: nothing to tell apart
MOST_EVIDENCE = 8.0  # more than a letter's evidence can be: twice the number of letters, as a ratio of likelihoods
BLOCK = 64  # dots that are weighed at once


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
    groups, count = len(model.direction), len(model.level)
    share = np.float32(0.5) / np.float32(count)
    measure = np.empty((7, BLOCK), np.float32)
    hue = np.empty((groups, BLOCK), np.float32)
    value = np.empty((count, BLOCK), np.float32)
    total = np.empty(BLOCK, np.float32)
    best = np.empty(BLOCK, np.float32)
    to = np.empty(BLOCK, np.int32)
    for begin in range(0, len(signal), BLOCK):
        m = min(BLOCK, len(signal) - begin)
        for i in range(m):
            j = begin + i
            measure[0, i], measure[1, i], measure[2, i] = colour[j, 0], colour[j, 1], colour[j, 2]
            measure[3, i] = noise[j]
            measure[4, i] = profile[j]
            measure[5, i] = signal[j] - field[j]
            measure[6, i] = field_variance[j]
        _normalise(measure)
        for g in range(groups):
            variance, weight = model.spread[g] * model.spread[g], np.float32(1) / model.profile_spread[g]
            _weigh_hue(measure, model.direction[g], variance, model.profile[g], weight, hue[g])
        total[:] = np.float32(HUE_FLOOR)
        best[:] = np.float32(-1)
        to[:] = 0
        for k in range(count):
            variance, stray = model.level_spread[k] * model.level_spread[k], np.float32(model.stray)
            of_group = hue[model.group[k]]
            _weigh_level(
                measure, of_group, np.int32(k), model.level[k], variance, stray, share, value[k], total, best, to
            )
        for k in range(count):
            row = value[k]
            for i in range(BLOCK):
                row[i] = logarithm((row[i] + np.float32(OUTLIER * HUE_FLOOR)) / total[i])
        for i in range(m):
            letter[begin + i] = to[i]
            for k in range(count):
                out[begin + i, k] = value[k, i]


@compiled
def _normalise(measure):
    """Colours of a block (rows 0 to 2 of measure) to unit length, their noise (3) to the variance of the angle."""
    for i in range(BLOCK):
        a, b, c = measure[0, i], measure[1, i], measure[2, i]
        scale = np.float32(1) / max(np.sqrt(a * a + b * b + c * c), np.float32(1e-6))
        measure[0, i], measure[1, i], measure[2, i] = a * scale, b * scale, c * scale
        e = measure[3, i] * scale
        measure[3, i] = e * e


@compiled
def _weigh_hue(measure, direction, angle_variance, profile, profile_weight, out):
    """Likelihood (BLOCK,) of a group's hue and shape."""
    d0, d1, d2 = direction[0], direction[1], direction[2]
    for i in range(BLOCK):
        d = measure[0, i] * d0 + measure[1, i] * d1 + measure[2, i] * d2
        misfit = np.float32(2) * max(np.float32(1) - d, np.float32(0)) / (angle_variance + measure[3, i])
        z = (measure[4, i] - profile) * profile_weight
        misfit += z * z if z == z else np.float32(0)
        out[i] = exponential(np.float32(-0.5) * misfit)


@compiled
def _weigh_level(measure, hue, this, level, level_variance, stray, share, out, total, best, letter):
    """Likelihood out (BLOCK,) of the letter `this`, from that of its hue (BLOCK,) and its level.

    Adds to the total of what is not a dot; best, letter (BLOCK,): the best value so far and its letter.
    """
    one, zero = np.float32(1), np.float32(0)
    broad = np.float32(1 / LEVEL_RANGE)
    for i in range(BLOCK):
        e = measure[5, i] - level
        precision = one / np.sqrt(level_variance + measure[3, i] + measure[6, i])
        z = e * precision
        near = np.float32(0.39894) * precision * exponential(np.float32(-0.5) * z * z)
        total[i] += hue[i] * share * (near + broad)
        v = hue[i] * ((one - stray) * near + stray * broad)
        out[i] = v
        # where strays tie, the nearer level is the letter
        v += np.float32(1e-9) * hue[i] * max(np.float32(64) - e * e, zero)
        letter[i] = this if v > best[i] else letter[i]
        best[i] = max(v, best[i])


@compiled
def any_letter(evidence, share):
    """Evidence (N,) for a dot of any of the map's letters, at least 0: what is no dot speaks against every place.

    evidence (N, A): see `letter_evidence`; share (A,) of the map's dots. That a dot looks like one speaks for no place:
    less this, the evidence for each letter averages one (as a ratio of likelihoods) over the map, whatever the letters
    were taken for.
    """
    n, count = evidence.shape
    most = np.float32(MOST_EVIDENCE)
    ratio = np.empty(n * count, np.float32)
    flat = evidence.ravel()
    for k in range(len(ratio)):
        ratio[k] = exponential(flat[k] - most)
    out = np.zeros(n, np.float32)
    for i in range(n):
        for k in range(count):
            out[i] += np.float32(share[k]) * ratio[i * count + k]
    for i in range(n):
        out[i] = max(most + logarithm(out[i]), np.float32(0))
    return out


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
    """Median of pool (N,), which is overwritten, and spread from the absolute deviation, within [least, most]."""
    middle = quantile(pool, 0.5)
    for k in range(len(pool)):
        pool[k] = abs(pool[k] - middle)
    return middle, min(max(np.float32(1.48) * quantile(pool, 0.5), np.float32(least)), np.float32(most))


@compiled
def _fit_direction(unit, direction, pool):
    """Robust mean of unit colours (3, N), in place of direction (3,); returns the spread of the angle.

    Two rounds, the second without outliers; fewer than five dots leave the direction as it is. pool (N,): work space.
    """
    one, two = np.float32(1), np.float32(2)
    spread = np.float32(0.15)
    for turn in range(2):
        t0 = t1 = t2 = np.float32(0)
        d0, d1, d2 = direction[0], direction[1], direction[2]
        limit = np.float32(9) * spread * spread if turn == 1 else np.float32(8)
        for i in range(len(pool)):
            p, q, r = unit[0, i], unit[1, i], unit[2, i]
            w = one if two * (one - (p * d0 + q * d1 + r * d2)) <= limit else np.float32(0)
            t0 += w * p
            t1 += w * q
            t2 += w * r
        norm = np.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
        if norm < 5:
            break
        d0, d1, d2 = t0 / norm, t1 / norm, t2 / norm
        direction[0], direction[1], direction[2] = d0, d1, d2
        for i in range(len(pool)):
            pool[i] = two * max(one - (unit[0, i] * d0 + unit[1, i] * d1 + unit[2, i] * d2), np.float32(0))
        spread = np.sqrt(quantile(pool, 0.5) / np.float32(1.39))
        spread = min(max(spread, np.float32(0.02)), np.float32(0.5))
    return spread


@compiled
def _fit(model, colour, profile, signal, field, letter, use, several_shapes):
    """Fit the arrays of a model in place, to a sample; returns the share of dots off the field.

    Directions and levels of which there are next to no dots stay as they are."""
    model.profile[:], model.profile_spread[:] = 0, ANY_PROFILE
    model.level_spread[:] = np.float32(0.2)
    chosen = sample(use, len(model.level))
    pool = np.empty(len(chosen), np.float32)
    length = np.empty(len(chosen), np.float32)
    unit = np.empty((3, len(chosen)), np.float32)
    for s in range(len(chosen)):
        i = chosen[s]
        length[s] = np.sqrt(colour[i, 0] * colour[i, 0] + colour[i, 1] * colour[i, 1] + colour[i, 2] * colour[i, 2])
    for g in range(len(model.direction)):
        m = 0
        members = 0
        for s in range(len(chosen)):
            i = chosen[s]
            member = model.group[letter[i]] == g
            pool[members] = profile[i]
            members += np.int64(member and profile[i] == profile[i])
            for c in range(3):
                unit[c, m] = colour[i, c] / length[s]
            m += np.int64(member and length[s] > 1)
        if several_shapes and members >= 5:
            model.profile[g], model.profile_spread[g] = _middle_and_spread(pool[:members], 0.01, ANY_PROFILE)
        model.spread[g] = _fit_direction(unit, model.direction[g], pool[:m])
    for a in range(len(model.level)):
        m = 0
        for i in chosen:
            pool[m] = signal[i] - field[i]
            m += np.int64(letter[i] == a)
        if m >= 5:
            model.level[a], model.level_spread[a] = _middle_and_spread(pool[:m], 0.03, 0.6)
    if len(chosen) < 50:
        return FIRST_STRAY
    off = 0
    for i in chosen:
        a = letter[i]
        off += abs(signal[i] - field[i] - model.level[a]) > 4 * model.level_spread[a] + np.float32(0.1)
    return min(max(1.2 * off / len(chosen), 0.02), 0.4)


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
        spread=np.empty(groups, np.float32),
        profile=np.empty(groups, np.float32),
        profile_spread=np.empty(groups, np.float32),
        level=level.copy(),
        level_spread=np.empty(len(level), np.float32),
        stray=np.float32(FIRST_STRAY),
    )
    several = len(alphabet.profiles) > 1
    return model._replace(stray=np.float32(_fit(model, colour, profile, signal, field, letter, use, several)))
