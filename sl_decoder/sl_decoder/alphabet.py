"""The alphabet of a pattern as the decoder reads it: hue groups, intensity levels and shapes of its letters."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pattern_gen import Pattern
from pattern_gen.rendering import coverage
from sl_decoder.segmentation import FOOT_RATIO

UPPER_TAIL = 0.9  # quantile of a channel's drive values and of its signals by which gains are told
BLURS = (0.1, 0.17, 0.25, 0.35, 0.5)  # of the images of the shapes that are compared [diameters]
CORE = 0.5  # share of its height above which a dot's core lies
SAME_HUE = 0.995  # cosine between the drive colours of letters that differ in intensity only


@dataclass(frozen=True)
class Alphabet:
    """What the pattern says of its A letters.

    hue (A,) and shape (A,) index; group (A,) int32 hue and shape together; hue_colour (H, 3) mean B, G, R drive values
    0..1 of a hue's letters; ranked (A,) letters, darkest first; share (A,) of the map's dots; upper (3,) drive value at
    UPPER_TAIL of the dots' channels; profiles (S,) radial kurtosis (log) of each shape, seen sharp; appearances: log
    signal and profile (A, 2) of the letters under each of BLURS, none where all have one shape.
    """

    hue: np.ndarray
    shape: np.ndarray
    group: np.ndarray
    hue_colour: np.ndarray
    ranked: np.ndarray
    share: np.ndarray
    upper: np.ndarray
    profiles: np.ndarray
    appearances: list[np.ndarray]


def sharp_profile(shape: str) -> float:
    """Logarithm of the radial kurtosis of a shape of the pattern, invariant under affine maps."""
    return _profile(coverage(shape, 48.0, np.array([[30.0, 30.0]]), 61)[0])


def _profile(mass: np.ndarray) -> float:
    """Logarithm of the radial kurtosis of a distribution (S, S), invariant under affine maps."""
    y, x = np.mgrid[: len(mass), : len(mass)] - 0.5 * (len(mass) - 1)
    covariance = np.array([[(mass * x * x).sum(), (mass * x * y).sum()], [(mass * x * y).sum(), (mass * y * y).sum()]])
    inverse = np.linalg.inv(covariance / mass.sum())
    r2 = inverse[0, 0] * x * x + 2 * inverse[0, 1] * x * y + inverse[1, 1] * y * y
    return float(np.log((mass * r2 * r2).sum() * mass.sum() / (mass * r2).sum() ** 2))


def appearance(shape: str, blur: float) -> tuple[float, float]:
    """What is measured of a shape's image under a blur [diameters]: log of the mean over its core, radial profile."""
    mask = coverage(shape, 24.0, np.array([[36.0, 36.0]]), 73)[0]
    image = cv2.GaussianBlur(mask, (0, 0), 24.0 * blur)
    core = image[image >= CORE * image.max()].mean()
    return float(np.log(core)), _profile(np.where(image >= FOOT_RATIO * image.max(), image, 0.0))


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
    drive = np.log(strength / strength.max())
    appearances = [
        np.array([np.add((drive[i], 0.0), appearance(names[shape[i]], blur)) for i in range(len(colour))])
        for blur in (BLURS if len(names) > 1 else ())
    ]
    return Alphabet(
        hue=hue,
        shape=shape,
        group=group,
        hue_colour=np.array([colour[hue == h].mean(0) for h in range(len(directions))]),
        ranked=np.argsort(level, kind="stable"),
        share=share,
        upper=np.sort(colour, axis=0)[tail, range(3)],
        profiles=np.array([sharp_profile(name) for name in names], np.float32),
        appearances=appearances,
    )
