"""Shared by this package's tests: small maps and camera views of them."""

import numpy as np

from pattern_gen import Grid, Letter, Pattern, default_pattern
from sl_decoder.benchmark import camera_image

__all__ = ["camera_image", "default_pattern", "hexagonal_pattern", "monochrome_pattern"]


def hexagonal_pattern(rows: int = 20, cols: int = 30, seed: int = 0) -> Pattern:
    """A random hexagonal map: its windows are unique with overwhelming probability."""
    symbols = np.random.default_rng(seed).integers(0, 6, (rows, cols)).astype(np.uint8)
    return Pattern(
        grid=Grid.HEXAGONAL, symbols=symbols, letters=default_pattern().letters, pitch=24.0, spot_diameter=11.0
    )


def monochrome_pattern(rows: int = 24, cols: int = 32, seed: int = 0) -> Pattern:
    """A random map of white letters: two shapes, two intensities."""
    symbols = np.random.default_rng(seed).integers(0, 4, (rows, cols)).astype(np.uint8)
    letters = tuple(Letter((drive,) * 3, shape) for shape in ("disc", "ring") for drive in (255, 140))
    return Pattern(grid=Grid.SQUARE, symbols=symbols, letters=letters, pitch=28.0, spot_diameter=15.0)
