"""Letters of dots: hue groups and intensity levels, learnt from the image itself.

No hue or intensity limit is fixed. The hue groups start from the pattern's colours under the gains seen in the image and
settle on the dots (k-means of colour directions). Intensities only mean something relative to the surroundings: the
logarithm of a dot's signal is its letter's level plus a field (albedo, distance, shading, vignetting) that neighbours share;
levels and field are estimated in turn. Once dots are decoded the same model is fitted to their known letters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from pattern_gen import Pattern

SAME_HUE = 0.995  # cosine between the drive colours of letters that differ in intensity only
OUTLIER = 0.02  # share of dots whose letter cannot be trusted whatever the model says
FLOOR = 1e-3


@dataclass(frozen=True)
class Alphabet:
    """What the pattern says of its letters.

    colour (A, 3) float64 B, G, R drive values 0..1; group (A,) int32 hue group; direction (G, 3) unit colour of a group;
    level (A,) float64 logarithm of the drive relative to the group's brightest; share (A,) of the map's dots.
    """

    colour: np.ndarray
    group: np.ndarray
    direction: np.ndarray
    level: np.ndarray
    share: np.ndarray


def read_alphabet(pattern: Pattern) -> Alphabet:
    """The alphabet of a pattern."""
    colour = np.array([letter.rgb[::-1] for letter in pattern.letters], np.float64) / 255.0
    unit = colour / np.linalg.norm(colour, axis=1, keepdims=True)
    group = np.full(len(colour), -1, np.int32)
    directions: list[np.ndarray] = []
    for i, direction in enumerate(unit):
        for g, known in enumerate(directions):
            if direction @ known > SAME_HUE:
                group[i] = g
                break
        else:
            group[i] = len(directions)
            directions.append(direction)
    strength = np.linalg.norm(colour, axis=1)
    level = np.array([np.log(strength[i] / strength[group == group[i]].max()) for i in range(len(colour))])
    share = np.bincount(pattern.symbols.ravel(), minlength=len(colour)).astype(np.float64)
    return Alphabet(colour, group, np.array(directions), level, share / share.sum())


@dataclass
class LetterModel:
    """Fitted to one image: direction (G, 3) float32 unit colours, spread (G,) float32 of the angle [rad];
    level (A,) float32 log signal relative to the field, level_spread (A,)."""

    direction: np.ndarray
    spread: np.ndarray
    level: np.ndarray
    level_spread: np.ndarray


def channel_gains(alphabet: Alphabet, colour: np.ndarray) -> np.ndarray:
    """Gains (3,) that the channels of the image have over the drive values, from the upper tails of both."""
    gains = np.ones(3)
    for c in range(3):
        order = np.argsort(alphabet.colour[:, c])
        cumulative = np.cumsum(alphabet.share[order])
        reference = alphabet.colour[order[np.searchsorted(cumulative, 0.9)], c]
        if reference > 0.1:
            gains[c] = max(float(np.percentile(colour[:, c], 90)), 1e-3) / reference
        else:
            gains[c] = 0.0
    if (gains == 0).any():
        gains[gains == 0] = gains[gains > 0].mean() if (gains > 0).any() else 1.0
    return gains


@njit(cache=True, boundscheck=False, fastmath=True)
def _assign_groups(colour, direction, group):  # type: ignore[no-untyped-def]
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


@njit(cache=True, boundscheck=False, fastmath=True)
def local_field(signal, near, letter, level, use, field):  # type: ignore[no-untyped-def]
    """Mean over each dot's neighbours of log signal minus their letter's level."""
    n, k = near.shape
    for i in range(n):
        total = 0.0
        m = 0
        for q in range(k):
            j = near[i, q]
            if j < 0:
                break
            if use[j]:
                total += signal[j] - level[letter[j]]
                m += 1
        field[i] = total / m if m > 0 else signal[i] - level[letter[i]]


@njit(cache=True, boundscheck=False, fastmath=True)
def _assign_levels(signal, field, group, letter_group, level, letter):  # type: ignore[no-untyped-def]
    n = len(signal)
    for i in range(n):
        best = 1e30
        for a in range(len(level)):
            if letter_group[a] == group[i]:
                d = abs(signal[i] - field[i] - level[a])
                if d < best:
                    best = d
                    letter[i] = a


@njit(cache=True, boundscheck=False, fastmath=True)
def log_likelihood(colour, signal, field, noise, letter_group, direction, spread, level, level_spread, out):  # type: ignore[no-untyped-def]
    """Log-posterior (N, A) of each letter under a uniform prior, with a share of outliers."""
    n = len(signal)
    a = len(level)
    angle = np.empty(len(direction))
    for i in range(n):
        p, q, r = colour[i, 0], colour[i, 1], colour[i, 2]
        norm = np.sqrt(p * p + q * q + r * r)
        relative = noise[i] / max(norm, 1e-6)
        for g in range(len(direction)):
            d = (p * direction[g, 0] + q * direction[g, 1] + r * direction[g, 2]) / max(norm, 1e-6)
            angle[g] = 2.0 * max(1.0 - d, 0.0) / (spread[g] * spread[g] + relative * relative)
        best = -1e30
        for k in range(a):
            e = signal[i] - field[i] - level[k]
            s2 = level_spread[k] * level_spread[k] + relative * relative
            out[i, k] = -0.5 * (angle[letter_group[k]] + e * e / s2)
            best = max(best, out[i, k])
        total = 0.0
        for k in range(a):
            out[i, k] = np.exp(out[i, k] - best)
            total += out[i, k]
        # beyond four sigma in everything the dot fits no letter: flatten
        fit = np.exp(max(best + 8.0, -20.0)) if best < -8.0 else 1.0
        for k in range(a):
            out[i, k] = np.log((1.0 - OUTLIER) * fit * out[i, k] / total + (OUTLIER + (1.0 - OUTLIER) * (1.0 - fit)) / a)


def log_signal(colour: np.ndarray, direction: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Logarithm (N,) of each dot's signal along its group's colour direction."""
    projected = np.einsum("ij,ij->i", colour, direction[group])
    return np.log(np.maximum(projected, 0.5)).astype(np.float32)


def initial_letters(
    alphabet: Alphabet, colour: np.ndarray, near: np.ndarray, use: np.ndarray
) -> tuple[np.ndarray, LetterModel, np.ndarray, np.ndarray]:
    """First reading of all dots: letters (N,) int32, the model, log signal (N,) and its field (N,).

    colour (N, 3) float32; near (N, K) int32 neighbours; use (N,) bool: dots that look like part of a lattice.
    """
    chosen = colour[use] if use.sum() >= 9 else colour
    gains = channel_gains(alphabet, chosen)
    direction = alphabet.colour * gains
    start = np.array([direction[alphabet.group == g].mean(0) for g in range(len(alphabet.direction))])
    start += 0.08 * start.max(1, keepdims=True)  # some crosstalk is everywhere
    direction = (start / np.linalg.norm(start, axis=1, keepdims=True)).astype(np.float32)
    some = np.empty(len(chosen), np.int32)
    for _ in range(4):
        total = _assign_groups(chosen, direction, some)
        norm = np.linalg.norm(total, axis=1)
        ok = norm > 3.0
        direction[ok] = (total[ok] / norm[ok, None]).astype(np.float32)
    group = np.empty(len(colour), np.int32)
    _assign_groups(colour, direction, group)
    signal = log_signal(colour, direction, group)
    n_groups = len(direction)
    group_level = np.array([np.median(signal[use & (group == g)]) if (use & (group == g)).any() else 0.0 for g in range(n_groups)])
    # levels: start from the ranks of the deviation from the local mean, in the shares of the map
    letter = group.copy()
    field = np.empty(len(colour), np.float32)
    local_field(signal, near, letter, group_level.astype(np.float32), use, field)
    deviation = signal - field
    level = np.zeros(len(alphabet.group), np.float32)
    for g in range(n_groups):
        members = np.flatnonzero(alphabet.group == g)
        members = members[np.argsort(alphabet.level[members])]
        values = np.sort(deviation[use & (group == g)])
        if not len(values):
            continue
        edges = np.concatenate([[0.0], np.cumsum(alphabet.share[members])]) / alphabet.share[members].sum()
        for low, high, a in zip(edges[:-1], edges[1:], members, strict=True):
            part = values[int(low * len(values)) : max(int(high * len(values)), int(low * len(values)) + 1)]
            level[a] = np.median(part) if len(part) else 0.0
    letter = np.empty(len(colour), np.int32)
    letter_group = alphabet.group
    for _ in range(3):
        _assign_levels(signal, field, group, letter_group, level, letter)
        for a in range(len(level)):
            mine = use & (letter == a)
            if mine.sum() >= 3:
                level[a] = (signal[mine] - field[mine]).mean()
        local_field(signal, near, letter, level, use, field)
    _assign_levels(signal, field, group, letter_group, level, letter)
    model = fit_model(alphabet, colour, signal, field, letter, use, direction, level)
    return letter, model, signal, field


def fit_model(alphabet: Alphabet, colour: np.ndarray, signal: np.ndarray, field: np.ndarray, letter: np.ndarray,
              use: np.ndarray, direction: np.ndarray, level: np.ndarray) -> LetterModel:
    """Directions, levels and their spreads from dots of (presumably) known letters."""
    direction = direction.copy()
    level = level.copy()
    spread = np.full(len(direction), 0.15, np.float32)
    level_spread = np.full(len(level), 0.2, np.float32)
    norm = np.linalg.norm(colour, axis=1)
    unit = colour / np.maximum(norm, 1e-6)[:, None]
    for g in range(len(direction)):
        mine = use & (alphabet.group[letter] == g) & (norm > 1)
        if mine.sum() >= 5:
            mean = np.median(unit[mine], axis=0)
            direction[g] = mean / np.linalg.norm(mean)
            angle2 = 2.0 * np.maximum(1.0 - unit[mine] @ direction[g], 0.0)
            spread[g] = np.clip(np.sqrt(np.median(angle2) / 1.39), 0.02, 0.5)
    for a in range(len(level)):
        mine = use & (letter == a)
        if mine.sum() >= 5:
            deviation = signal[mine] - field[mine]
            level[a] = np.median(deviation)
            level_spread[a] = np.clip(1.48 * np.median(np.abs(deviation - level[a])), 0.03, 0.6)
    return LetterModel(direction, spread, level, level_spread)
