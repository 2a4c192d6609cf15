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
from sl_decoder.intensity_field import first_levels, local_field
from sl_decoder.letter_model import LetterModel, fit_model, log_signal
from sl_decoder.quantiles import quantile, sample
from sl_decoder.shape_letters import read_shapes, with_shapes

CROSSTALK = 0.08  # share of a hue's strongest channel that every channel sees of it, before anything is known


@compiled
def seen_hues(hue_colour, upper, colour, use, letters):
    """Unit directions (H, 3) float32 of the hues, from drive values (H, 3) and the gains of the image's channels.

    The gains are those of the channels' upper tails: upper (3,) drive value at UPPER_TAIL of the dots, and the signals
    at the same quantile of a sample of the dots in use. colour (N, 3); use (N,) bool; letters: their number.
    """
    chosen = sample(use, letters)
    pool = np.empty(len(chosen), np.float32)
    gain = np.zeros(3)
    known = 0
    for c in range(3):
        for s in range(len(chosen)):
            pool[s] = colour[chosen[s], c]
        if upper[c] > 0.1:
            gain[c] = max(quantile(pool, UPPER_TAIL), np.float32(1e-3)) / upper[c]
            known += 1
    usual = gain.sum() / known if known > 0 else 1.0
    direction = np.empty(hue_colour.shape, np.float32)
    for h in range(len(hue_colour)):
        seen = hue_colour[h] * np.where(gain > 0, gain, usual)
        seen += CROSSTALK * seen.max()
        direction[h] = seen / np.sqrt((seen * seen).sum())
    return direction


@compiled
def _nearest_hues(unit, direction, cosine, group):
    """Direction nearest to each unit colour (3, N), and the cosine of the angle between them."""
    cosine[:] = np.float32(-2)
    for k in range(len(direction)):
        d0, d1, d2, this = direction[k, 0], direction[k, 1], direction[k, 2], np.int32(k)
        for i in range(len(group)):
            d = unit[0, i] * d0 + unit[1, i] * d1 + unit[2, i] * d2
            group[i] = this if d > cosine[i] else group[i]
            cosine[i] = max(d, cosine[i])


@compiled
def assign_hues(colour, use, direction, group):
    """Settle unit directions (G, 3) float32 on the dots in use (N,) bool, in place; writes the nearest of each dot.

    Four rounds of k-means by angle; a direction with hardly any dot stays where it is.
    """
    n = len(colour)
    one, zero = np.float32(1), np.float32(0)
    unit = np.empty((3, n), np.float32)
    for i in range(n):
        a, b, c = colour[i, 0], colour[i, 1], colour[i, 2]
        scale = one / max(np.sqrt(a * a + b * b + c * c), np.float32(1e-6))
        unit[0, i], unit[1, i], unit[2, i] = a * scale, b * scale, c * scale
    cosine = np.empty(n, np.float32)
    for _ in range(4):
        _nearest_hues(unit, direction, cosine, group)
        for k in range(len(direction)):
            a = b = c = zero
            for i in range(n):
                weight = one if group[i] == k and use[i] and cosine[i] > np.float32(0.5) else zero
                a += weight * unit[0, i]
                b += weight * unit[1, i]
                c += weight * unit[2, i]
            norm = np.sqrt(a * a + b * b + c * c)
            if norm > 3.0:
                direction[k, 0], direction[k, 1], direction[k, 2] = a / norm, b / norm, c / norm
    _nearest_hues(unit, direction, cosine, group)


def initial_letters(
    alphabet: Alphabet,
    centre: np.ndarray,
    colour: np.ndarray,
    profile: np.ndarray,
    near: np.ndarray,
    use: np.ndarray,
    first: np.ndarray | None = None,
) -> tuple[LetterModel, np.ndarray, np.ndarray, np.ndarray]:
    """First reading of all dots: the model of their letters, log signal (N,), its field (N,) and the field's variance.

    colour (N, 3) float32; profile (N,) radial kurtosis; near (N, K) int32 neighbours; use (N,) bool: dots that look
    like part of a lattice; first (A, 3) B G R of the letters from a colour calibration, None: the pattern's own under
    the gains of the image.
    """
    enough = use if np.count_nonzero(use) >= 9 else np.ones_like(use)
    hues, shapes = len(alphabet.hue_colour), len(alphabet.profiles)
    if first is None:
        direction = seen_hues(alphabet.hue_colour, alphabet.upper, colour, enough, len(alphabet.group))
    else:
        direction = np.array([first[alphabet.hue == h].mean(0) for h in range(hues)], np.float32)
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    n = len(colour)
    group = np.empty(n, np.int32)
    assign_hues(colour, enough, direction, group)
    letter = np.zeros(n, np.int32)
    field = np.empty(n, np.float32)
    variance = np.empty(n, np.float32)
    signal = log_signal(colour, direction, group)
    if shapes > 1:
        letter, mixture = read_shapes(alphabet, group, signal, profile, near, enough)
        level = mixture.mean[:, 0].astype(np.float32)
        direction = np.repeat(direction, shapes, axis=0)
    else:
        level = np.zeros(len(alphabet.group), np.float32)
        first_levels(
            signal, group, near, use, alphabet.group, alphabet.ranked, alphabet.share, hues, level, letter, field
        )
    local_field(centre, signal, near, letter, level, use, field, variance)
    model = fit_model(alphabet, colour, profile, signal, field, letter, use, direction, level)
    if shapes > 1:
        model = with_shapes(model, mixture, alphabet)
    return model, signal, field, variance
