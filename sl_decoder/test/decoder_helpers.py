"""Shared by this package's tests: small maps and camera views of them."""

import cv2
import numpy as np

from pattern_gen import Grid, Letter, Pattern, default_pattern
from sl_decoder.benchmark import camera_image

__all__ = ["camera_image", "default_pattern", "hexagonal_pattern", "monochrome_pattern", "project"]


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


def project(
    pattern,
    affine: np.ndarray,
    size=(640, 480),
    *,
    blur: float = 0.6,
    light: float = 1.0,
    noise: float = 3.0,
    ambient: float = 20.0,
    seed: int = 0,
) -> np.ndarray:
    """Camera image (H, W, 3) uint8 BGR of a pattern under an affine view: blur, ambient light, noise."""
    image = cv2.warpAffine(pattern.render()[:, :, ::-1], affine, size, flags=cv2.INTER_AREA)
    image = light * cv2.GaussianBlur(image, (0, 0), blur).astype(np.float32) + ambient
    return np.clip(image + np.random.default_rng(seed).normal(0, noise, image.shape), 0, 255).astype(np.uint8)
