"""Dots as a perfect camera would measure them.

With wrong letters and missing dots on demand: to test and to benchmark.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pattern_gen import Pattern
from sl_decoder.centres import Dots


def view(pattern: Pattern, *, angle: float = 0.0, scale: float = 0.6, seed: int = 0) -> NDArray[np.float64]:
    """Affine map (2, 3) from projector px to camera px: a roll by `angle` [rad], foreshortened by up to a third."""
    rng = np.random.default_rng(seed)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    tilt = turn @ np.diag([1.0, rng.uniform(0.67, 1.0)]) * scale
    middle = 0.5 * np.array([pattern.projector_width, pattern.projector_height])
    return np.hstack([tilt, (np.array([320.0, 240.0]) - tilt @ middle)[:, None]])


def synthetic_dots(
    pattern: Pattern, *, flipped: float = 0.0, missing: float = 0.0, angle: float = 0.3, seed: int = 0
) -> tuple[Dots, NDArray[np.int64]]:
    """All dots of a pattern in one view, and the map index (row * cols + col) of each.

    flipped: share of dots that show another letter; missing: share that is not there.
    """
    rng = np.random.default_rng(seed)
    affine = view(pattern, angle=angle, seed=seed)
    kept = np.flatnonzero(rng.random(pattern.symbols.size) >= missing)
    letters = pattern.symbols.ravel()[kept].astype(np.int64)
    wrong = rng.random(len(kept)) < flipped
    letters[wrong] = (letters[wrong] + rng.integers(1, pattern.alphabet, wrong.sum())) % pattern.alphabet
    centre = pattern.centers.reshape(-1, 2)[kept] @ affine[:, :2].T + affine[:, 2] + rng.normal(0, 0.05, (len(kept), 2))
    drive = np.array([letter.rgb[::-1] for letter in pattern.letters], np.float64)[letters]
    colour = 0.8 * drive * np.exp(rng.normal(0, 0.03, (len(kept), 1))) + rng.normal(0, 1.5, (len(kept), 3))
    shape = affine[:, :2] @ affine[:, :2].T * pattern.spot_diameter**2 / 16
    n = len(kept)
    dots = Dots(
        centre=centre.astype(np.float32),
        colour=colour.astype(np.float32),
        covariance=np.tile(np.array([shape[0, 0], shape[0, 1], shape[1, 1]], np.float32), (n, 1)),
        area=np.full(n, 12, np.int32),
        noise=np.full(n, 1.0, np.float32),
        saturated=np.zeros(n, np.float32),
        cut=np.zeros(n, np.bool_),
        profile=np.full(n, 0.35, np.float32),
    )
    return dots, kept
