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

from sl_decoder.alphabet import UPPER_TAIL, Alphabet
from sl_decoder.compiled import compiled
from sl_decoder.intensity_field import first_levels, local_field, quantile
from sl_decoder.letter_model import LetterModel, fit_model, log_signal


def channel_gains(alphabet: Alphabet, colour: np.ndarray, use: np.ndarray) -> np.ndarray:
    """Gains (3,) that the channels of the image have over the drive values, from the upper tails of both."""
    reference = alphabet.upper
    gains = np.where(reference > 0.1, np.maximum(upper_tails(colour, use), 1e-3) / np.maximum(reference, 0.1), 0.0)
    seen = gains > 0
    gains[~seen] = gains[seen].mean() if seen.any() else 1.0
    return gains


@compiled
def upper_tails(colour, use):
    """Quantiles (3,) at UPPER_TAIL of the channels of colour (N, 3) over the dots in use (N,) bool."""
    pool = np.empty(len(colour), np.float32)
    out = np.empty(3)
    for c in range(3):
        m = 0
        for i in range(len(colour)):
            pool[m] = colour[i, c]
            m += np.int64(use[i])
        out[c] = quantile(pool[:m], UPPER_TAIL)
    return out


@compiled
def assign_hues(colour, use, direction, group):
    """Settle unit directions (G, 3) float32 on the dots in use (N,) bool, in place; writes the nearest of each dot.

    Four rounds of k-means by angle; a direction with hardly any dot stays where it is.
    """
    n = len(colour)
    g = len(direction)
    unit = np.empty((n, 3), np.float32)
    for i in range(n):
        a, b, c = colour[i, 0], colour[i, 1], colour[i, 2]
        norm = np.sqrt(a * a + b * b + c * c)
        scale = np.float32(1) / norm if norm > 0 else np.float32(0)
        unit[i, 0], unit[i, 1], unit[i, 2] = a * scale, b * scale, c * scale
    total = np.empty((g, 3))
    for turn in range(5):
        total[:] = 0
        for i in range(n):
            a, b, c = unit[i, 0], unit[i, 1], unit[i, 2]
            best = np.float32(-2)
            to = 0
            for k in range(g):
                d = a * direction[k, 0] + b * direction[k, 1] + c * direction[k, 2]
                to = k if d > best else to
                best = max(d, best)
            group[i] = to
            if use[i] and best > np.float32(0.5):
                total[to, 0] += a
                total[to, 1] += b
                total[to, 2] += c
        for k in range(g):
            norm = np.sqrt((total[k] * total[k]).sum())
            if norm > 3.0 and turn < 4:
                direction[k] = total[k] / norm


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
    enough = use if np.count_nonzero(use) >= 9 else np.ones_like(use)
    letter_colour = alphabet.colour * channel_gains(alphabet, colour, enough) if first is None else first
    hues = int(alphabet.hue.max()) + 1
    shapes = len(alphabet.profiles)
    start = np.array([letter_colour[alphabet.hue == h].mean(0) for h in range(hues)])
    if first is None:
        start += 0.08 * start.max(1, keepdims=True)  # some crosstalk is everywhere
    direction = (start / np.linalg.norm(start, axis=1, keepdims=True)).astype(np.float32)
    n = len(colour)
    group = np.empty(n, np.int32)
    assign_hues(colour, enough, direction, group)
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
