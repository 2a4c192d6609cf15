"""The alphabet of a pattern as the decoder reads it: hue groups, intensity levels and shapes of its letters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pattern_gen import Pattern
from pattern_gen.rendering import coverage

UPPER_TAIL = 0.9  # quantile of a channel's drive values and of its signals by which gains are told
SAME_HUE = 0.995  # cosine between the drive colours of letters that differ in intensity only


@dataclass(frozen=True)
class Alphabet:
    """What the pattern says of its A letters.

    hue (A,) and shape (A,) index; group (A,) int32 hue and shape together; hue_colour (H, 3) mean B, G, R drive values
    0..1 of a hue's letters; ranked (A,) letters, darkest first; share (A,) of the map's dots; upper (3,) drive value at
    UPPER_TAIL of the dots' channels; profiles (S,) radial kurtosis (log) of each shape, seen sharp.
    """

    hue: np.ndarray
    shape: np.ndarray
    group: np.ndarray
    hue_colour: np.ndarray
    ranked: np.ndarray
    share: np.ndarray
    upper: np.ndarray
    profiles: np.ndarray


def sharp_profile(shape: str) -> float:
    """Logarithm of the radial kurtosis of a shape of the pattern, invariant under affine maps."""
    mask = coverage(shape, 48.0, np.array([[30.0, 30.0]]), 61)[0]
    y, x = np.mgrid[:61, :61] - 30.0
    covariance = np.array([[(mask * x * x).sum(), (mask * x * y).sum()], [(mask * x * y).sum(), (mask * y * y).sum()]])
    inverse = np.linalg.inv(covariance / mask.sum())
    r2 = inverse[0, 0] * x * x + 2 * inverse[0, 1] * x * y + inverse[1, 1] * y * y
    return float(np.log((mask * r2 * r2).sum() * mask.sum() / (mask * r2).sum() ** 2))


def read_alphabet(pattern: Pattern) -> Alphabet:
    """The alphabet of a pattern."""
    colour = np.array([letter.rgb[::-1] for letter in pattern.letters], np.float64) / 255.0
    unit = colour / np.linalg.norm(colour, axis=1, keepdims=True)
    hue = np.full(len(colour), -1, np.int32)
    directions: list[np.ndarray] = []
    for i, direction in enumerate(unit):
        for g, known in enumerate(directions):
            if direction @ known > SAME_HUE:
                hue[i] = g
                break
        else:
            hue[i] = len(directions)
            directions.append(direction)
    names = sorted({letter.shape for letter in pattern.letters}, key=sharp_profile)
    shape = np.array([names.index(letter.shape) for letter in pattern.letters], np.int32)
    group = (hue * len(names) + shape).astype(np.int32)
    strength = np.linalg.norm(colour, axis=1)
    level = np.array([np.log(strength[i] / strength[group == group[i]].max()) for i in range(len(colour))])
    share = np.bincount(pattern.symbols.ravel(), minlength=len(colour)).astype(np.float64)
    share /= share.sum()
    order = np.argsort(colour, axis=0)
    tail = [min(int(np.searchsorted(np.cumsum(share[one]), UPPER_TAIL)), len(one) - 1) for one in order.T]
    return Alphabet(
        hue=hue,
        shape=shape,
        group=group,
        hue_colour=np.array([colour[hue == h].mean(0) for h in range(len(directions))]),
        ranked=np.argsort(level, kind="stable"),
        share=share,
        upper=np.sort(colour, axis=0)[tail, range(3)],
        profiles=np.array([sharp_profile(name) for name in names], np.float32),
    )
