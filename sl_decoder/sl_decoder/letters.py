"""First reading of the letters: hue groups and intensity levels, learnt from the image itself.

No hue or intensity limit is fixed. The hue groups start from the pattern's colours under the gains seen in the image
and settle on the dots (k-means of colour directions). Intensities only mean something relative to the surroundings: the
logarithm of a dot's signal is its letter's level plus a field (albedo, distance, shading, vignetting) that neighbours
share; levels and field are estimated in turn. Once dots are decoded the same model is fitted to their known letters.
"""

# mypy: allow-untyped-defs, no-check-untyped-defs
# (compiled functions get their types from their arguments)

from __future__ import annotations

import numpy as np

from sl_decoder.alphabet import Alphabet
from sl_decoder.compiled import compiled
from sl_decoder.intensity_field import first_levels, local_field, quantile
from sl_decoder.letter_model import LetterModel, fit_model, log_signal


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
