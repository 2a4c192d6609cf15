"""Letters of dots: hue groups and intensity levels, learnt from the image itself.

No hue or intensity limit is fixed. The hue groups start from the pattern's colours under the gains seen in the image
and settle on the dots (k-means of colour directions). Intensities only mean something relative to the surroundings: the
logarithm of a dot's signal is its letter's level plus a field (albedo, distance, shading, vignetting) that neighbours
share; levels and field are estimated in turn. Once dots are decoded the same model is fitted to their known letters.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sl_decoder.alphabet import Alphabet
from sl_decoder.compiled import compiled
from sl_decoder.intensity_field import first_levels, local_field, quantile

OUTLIER = 0.04  # share of true dots that fit no hue, over that of false ones
HUE_FLOOR = 3e-4  # likelihood from which on a hue counts as none of the letters': four sigmas
LEVEL_RANGE = 4.0  # log signal over which intensities that do not follow the field are spread
FIRST_STRAY = 0.1  # share of such dots before anything is decoded


@dataclass
class LetterModel:
    """Fitted to one image. Per group (G,): direction (G, 3) float32 unit colour, spread of the angle [rad], profile and
    profile_spread of the radial kurtosis; per letter (A,): level (log signal relative to the field) and level_spread;
    stray: share of dots off the field."""

    direction: np.ndarray
    spread: np.ndarray
    profile: np.ndarray
    profile_spread: np.ndarray
    level: np.ndarray
    level_spread: np.ndarray
    stray: float = FIRST_STRAY

    def arrays(self) -> tuple[Any, ...]:
        """The model as the compiled functions take it."""
        return (
            self.direction,
            self.spread,
            self.profile,
            self.profile_spread,
            self.level,
            self.level_spread,
            np.float32(self.stray),
        )


def channel_gains(alphabet: Alphabet, colour: np.ndarray) -> np.ndarray:
    """Gains (3,) that the channels of the image have over the drive values, from the upper tails of both."""
    gains = np.zeros(3)
    for c in range(3):
        order = np.argsort(alphabet.colour[:, c])
        cumulative = np.cumsum(alphabet.share[order])
        reference = alphabet.colour[order[min(int(np.searchsorted(cumulative, 0.9)), len(order) - 1)], c]
        if reference > 0.1:
            gains[c] = max(float(quantile(colour[:, c].copy(), 0.9)), 1e-3) / reference
    seen = gains > 0
    gains[~seen] = gains[seen].mean() if seen.any() else 1.0
    return gains


@compiled
def _assign_groups(colour, direction, group):
    """Nearest direction of each dot; returns sums of unit colours per group."""
    n = len(colour)
    g = len(direction)
    total = np.zeros((g, 3))
    for i in range(n):
        a, b, c = colour[i, 0], colour[i, 1], colour[i, 2]
        norm = np.sqrt(a * a + b * b + c * c)
        best = -2.0
        to = 0
        if norm > 0:
            for k in range(g):
                d = (a * direction[k, 0] + b * direction[k, 1] + c * direction[k, 2]) / norm
                if d > best:
                    best = d
                    to = k
            if best > 0.5:
                total[to, 0] += a / norm
                total[to, 1] += b / norm
                total[to, 2] += c / norm
        group[i] = to
    return total


@compiled
def _fit(
    colour,
    profile,
    signal,
    field,
    letter,
    use,
    letter_group,
    direction,
    spread,
    profile_mean,
    profile_spread,
    level,
    level_spread,
):
    """Robust directions, levels and spreads, in place; returns the share of dots off the field."""
    n = len(signal)
    pool = np.empty(n, np.float32)
    for g in range(len(direction)):
        total = np.zeros(3, np.float32)
        # two rounds of the mean direction, the second without outliers
        for turn in range(2):
            total[:] = 0
            for i in range(n):
                if not use[i] or letter_group[letter[i]] != g:
                    continue
                p, q, r = colour[i, 0], colour[i, 1], colour[i, 2]
                norm = np.sqrt(p * p + q * q + r * r)
                if norm <= 1:
                    continue
                d = (p * direction[g, 0] + q * direction[g, 1] + r * direction[g, 2]) / norm
                if turn == 1 and np.float32(2) * (1 - d) > 9 * spread[g] * spread[g]:
                    continue
                total[0] += p / norm
                total[1] += q / norm
                total[2] += r / norm
            norm = np.sqrt(total[0] * total[0] + total[1] * total[1] + total[2] * total[2])
            if norm < 5:
                break
            for c in range(3):
                direction[g, c] = total[c] / norm
            m = 0
            for i in range(n):
                if not use[i] or letter_group[letter[i]] != g:
                    continue
                p, q, r = colour[i, 0], colour[i, 1], colour[i, 2]
                norm = max(np.sqrt(p * p + q * q + r * r), np.float32(1e-6))
                d = (p * direction[g, 0] + q * direction[g, 1] + r * direction[g, 2]) / norm
                pool[m] = np.float32(2) * max(1 - d, np.float32(0))
                m += 1
            spread[g] = min(max(np.sqrt(quantile(pool[:m], 0.5) / np.float32(1.39)), np.float32(0.02)), np.float32(0.5))
    if profile_spread[0] > 0:
        for g in range(len(direction)):
            m = 0
            for i in range(n):
                if use[i] and letter_group[letter[i]] == g:
                    pool[m] = profile[i]
                    m += 1
            if m >= 5:
                profile_mean[g] = quantile(pool[:m], 0.5)
                for k in range(m):
                    pool[k] = abs(pool[k] - profile_mean[g])
                profile_spread[g] = max(np.float32(1.48) * quantile(pool[:m], 0.5), np.float32(0.01))
    for a in range(len(level)):
        m = 0
        for i in range(n):
            if use[i] and letter[i] == a:
                pool[m] = signal[i] - field[i]
                m += 1
        if m < 5:
            continue
        level[a] = quantile(pool[:m], 0.5)
        for k in range(m):
            pool[k] = abs(pool[k] - level[a])
        level_spread[a] = min(max(np.float32(1.48) * quantile(pool[:m], 0.5), np.float32(0.03)), np.float32(0.6))
    off = 0
    m = 0
    for i in range(n):
        if use[i]:
            m += 1
            a = letter[i]
            if abs(signal[i] - field[i] - level[a]) > 4 * level_spread[a] + np.float32(0.1):
                off += 1
    if m < 50:
        return np.float32(FIRST_STRAY)
    return np.float32(min(max(1.2 * off / m, 0.02), 0.4))


@compiled
def letter_evidence(
    p,
    q,
    r,
    profile,
    signal,
    field,
    field_variance,
    noise,
    letter_group,
    direction,
    spread,
    profile_mean,
    profile_spread,
    level,
    level_spread,
    stray,
    out,
):
    """Evidence (A,) for each letter of one dot: log-likelihood ratio against a dot that happens to lie there.

    p, q, r: its B, G, R above the background; profile: its radial kurtosis, nan where not measured. stray: share of
    true dots whose intensity does not follow the field (next to albedo edges, in highlights); their hue still counts.
    False dots stray half of the time. A dot that fits no hue speaks against every letter. Returns the best letter.
    """
    count = len(level)
    norm = max(np.sqrt(p * p + q * q + r * r), np.float32(1e-6))
    relative = noise / norm
    relative *= relative
    best = np.float32(-1.0)
    letter = 0
    false = np.float32(HUE_FLOOR)
    broad = np.float32(1 / LEVEL_RANGE)
    for k in range(count):
        g = letter_group[k]
        d = (p * direction[g, 0] + q * direction[g, 1] + r * direction[g, 2]) / norm
        angle2 = np.float32(2) * max(np.float32(1) - d, np.float32(0))
        misfit = angle2 / (spread[g] * spread[g] + relative)
        if profile == profile:
            z = (profile - profile_mean[g]) / profile_spread[g]
            misfit += z * z
        hue = np.exp(np.float32(-0.5) * misfit)
        e = signal - field - level[k]
        s2 = level_spread[k] * level_spread[k] + relative + field_variance
        near = np.exp(np.float32(-0.5) * e * e / s2) / np.sqrt(np.float32(6.2832) * s2)
        false += hue * np.float32(0.5) * (near + broad) / count
        value = hue * ((1 - stray) * near + stray * broad)
        out[k] = value
        # where strays tie, the nearer level is the letter
        value = value + np.float32(1e-9) * hue / (np.float32(1) + e * e)
        if value > best:
            best = value
            letter = k
    for k in range(count):
        out[k] = np.log((out[k] + np.float32(OUTLIER * HUE_FLOOR)) / false)
    return letter


@compiled
def all_evidence(
    colour,
    profile,
    signal,
    field,
    field_variance,
    noise,
    letter_group,
    direction,
    spread,
    profile_mean,
    profile_spread,
    level,
    level_spread,
    stray,
    out,
    letter,
):
    """`letter_evidence` of N dots: writes the evidence (N, A) and the best letter (N,)."""
    for i in range(len(signal)):
        letter[i] = letter_evidence(
            colour[i, 0],
            colour[i, 1],
            colour[i, 2],
            profile[i],
            signal[i],
            field[i],
            field_variance[i],
            noise[i],
            letter_group,
            direction,
            spread,
            profile_mean,
            profile_spread,
            level,
            level_spread,
            stray,
            out[i],
        )


@compiled
def log_signal(colour, direction, group):
    """Logarithm (N,) of each dot's signal along its group's colour direction."""
    out = np.empty(len(colour), np.float32)
    for i in range(len(colour)):
        g = group[i]
        value = colour[i, 0] * direction[g, 0] + colour[i, 1] * direction[g, 1] + colour[i, 2] * direction[g, 2]
        out[i] = np.log(max(value, np.float32(0.5)))
    return out


@compiled
def split_shapes(profile, use, share, out):
    """Shape (N,) of each dot from its radial kurtosis: ranks cut in the map's shares, then k-means in one dimension."""
    shapes = len(share)
    values = profile[use].copy()
    values.sort()
    n = len(values)
    centre = np.zeros(shapes, np.float32)
    low = 0.0
    for s in range(shapes):
        high = low + share[s]
        centre[s] = values[min(n - 1, int(0.5 * (low + high) * n))] if n > 0 else np.float32(s)
        low = high
    for _ in range(8):
        total = np.zeros(shapes)
        number = np.zeros(shapes)
        for i in range(len(profile)):
            best = 0
            for s in range(1, shapes):
                if abs(profile[i] - centre[s]) < abs(profile[i] - centre[best]):
                    best = s
            out[i] = best
            if use[i]:
                total[best] += profile[i]
                number[best] += 1
        for s in range(shapes):
            if number[s] > 0:
                centre[s] = total[s] / number[s]


def initial_letters(
    alphabet: Alphabet,
    centre: np.ndarray,
    colour: np.ndarray,
    profile: np.ndarray,
    near: np.ndarray,
    use: np.ndarray,
    first: np.ndarray | None = None,
) -> tuple[np.ndarray, LetterModel, np.ndarray, np.ndarray, np.ndarray]:
    """First reading of all dots: letters (N,) int32, the model, log signal (N,), its field (N,) and the field's
    variance.

    colour (N, 3) float32; profile (N,) radial kurtosis; near (N, K) int32 neighbours; use (N,) bool: dots that look
    like part of a lattice; first (A, 3) B G R of the letters from a colour calibration, None: the pattern's own under
    the gains of the image.
    """
    chosen = colour[use] if use.sum() >= 9 else colour
    letter_colour = alphabet.colour * channel_gains(alphabet, chosen) if first is None else first
    hues = int(alphabet.hue.max()) + 1
    shapes = len(alphabet.profiles)
    start = np.array([letter_colour[alphabet.hue == h].mean(0) for h in range(hues)])
    if first is None:
        start += 0.08 * start.max(1, keepdims=True)  # some crosstalk is everywhere
    direction = (start / np.linalg.norm(start, axis=1, keepdims=True)).astype(np.float32)
    some = np.empty(len(chosen), np.int32)
    for _ in range(4):
        total = _assign_groups(chosen, direction, some)
        norm = np.linalg.norm(total, axis=1)
        settled = norm > 3.0
        direction[settled] = (total[settled] / norm[settled, None]).astype(np.float32)
    n = len(colour)
    group = np.empty(n, np.int32)
    _assign_groups(colour, direction, group)
    if shapes > 1:
        shape = np.zeros(n, np.int32)
        share = np.array([alphabet.share[alphabet.shape == s].sum() for s in range(shapes)])
        split_shapes(profile, use, share, shape)
        group = (group * shapes + shape).astype(np.int32)
        direction = np.repeat(direction, shapes, axis=0)
    signal = log_signal(colour, direction, group)
    level = np.zeros(len(alphabet.group), np.float32)
    letter = np.zeros(n, np.int32)
    field = np.empty(n, np.float32)
    variance = np.empty(n, np.float32)
    ranked = np.argsort(alphabet.level, kind="stable")
    first_levels(signal, group, near, use, alphabet.group, ranked, alphabet.share, hues * shapes, level, letter, field)
    local_field(centre, signal, near, letter, level, use, field, variance)
    model = fit_model(alphabet, colour, profile, signal, field, letter, use, direction, level)
    return letter, model, signal, field, variance


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
    direction, level = direction.copy(), level.copy()
    groups = len(direction)
    spread = np.full(groups, 0.15, np.float32)
    profile_mean = np.zeros(groups, np.float32)
    profile_spread = np.full(groups, 1e3, np.float32)
    level_spread = np.full(len(level), 0.2, np.float32)
    stray = _fit(
        colour,
        profile,
        signal,
        field,
        letter,
        use,
        alphabet.group,
        direction,
        spread,
        profile_mean,
        profile_spread,
        level,
        level_spread,
    )
    if len(alphabet.profiles) < 2:
        profile_spread[:] = 1e3  # one shape only: nothing to tell apart
    return LetterModel(direction, spread, profile_mean, profile_spread, level, level_spread, float(stray))
