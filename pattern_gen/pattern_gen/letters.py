"""Representations of letters: colours, intensities, shapes and their combinations (Morano's separation; section II)."""

from __future__ import annotations

from itertools import product

import numpy as np

from pattern_gen.pattern import Letter

PROJECTOR_GAMMA = 2.2  # light = drive ** gamma, of an ordinary projector before its calibration
DARKEST_LIGHT = 0.27  # light of the darkest intensity over that of the brightest: drive 140 of 255 at gamma 2.2


def intensity_drives(count: int, *, gamma: float = PROJECTOR_GAMMA, darkest: float = DARKEST_LIGHT) -> list[int]:
    """Drive values of `count` intensities, brightest first, at equal ratios of light.

    Equal ratios, since albedo and distance multiply what the camera sees: a ratio survives them, a difference does not.

    Args:
        count: number of intensities.
        gamma: response of the projector, light = (drive / 255) ** gamma.
        darkest: light of the last intensity over that of the first.
    """
    light = np.geomspace(1.0, darkest, count) if count > 1 else np.ones(1)
    return [int(np.floor(255.0 * value ** (1.0 / gamma))) for value in light]


def default_letters() -> tuple[Letter, ...]:
    """The paper's six letters: red, green and blue discs in two intensities."""
    bright, dark = intensity_drives(2)
    return tuple(
        Letter(tuple(drive if channel == colour else 0 for channel in range(3)))  # type: ignore[arg-type]
        for drive in (bright, dark)
        for colour in range(3)
    )


COLOURS: dict[str, tuple[int, int, int]] = {
    "red": (1, 0, 0),
    "green": (0, 1, 0),
    "blue": (0, 0, 1),
    "white": (1, 1, 1),
    "yellow": (1, 1, 0),
    "cyan": (0, 1, 1),
    "magenta": (1, 0, 1),
}
SHAPE_ORDER = ("disc", "ring", "cross", "square", "triangle")  # best told apart first


def combine(colours: list[str], intensities: int, shapes: list[str]) -> tuple[Letter, ...]:
    """All combinations of colours, intensities (brightest first) and shapes; colours vary fastest, shapes slowest.

    Args:
        colours: keys of COLOURS.
        intensities: number of intensities.
        shapes: keys of shapes.SHAPES.
    """
    return tuple(
        Letter((drive * COLOURS[colour][0], drive * COLOURS[colour][1], drive * COLOURS[colour][2]), shape)
        for shape, drive, colour in product(shapes, intensity_drives(intensities), colours)
    )


def choose_letters(count: int, *, monochrome: bool = False) -> tuple[Letter, ...]:
    """Letters for an alphabet size: primaries first, then a second intensity, then more colours, then shapes.

    Args:
        count: 2..36.
        monochrome: white only, told apart by shape and intensity, for cameras without colour.
    """
    colours = ["white"] if monochrome else ["red", "green", "blue"]
    if count <= len(colours):
        return combine(colours, 1, ["disc"])[:count]
    if not monochrome and count == 4:
        return combine(["red", "green", "blue", "white"], 1, ["disc"])
    if not monochrome and 7 <= count <= 8:
        colours = ["red", "green", "blue", "white"]
    for shapes, intensities in ((1, 2), (2, 2), (3, 2), (4, 2), (5, 2), (5, 3), (5, 4), (5, 8)):
        letters = combine(colours, intensities, list(SHAPE_ORDER[:shapes]))
        if len(letters) >= count:
            return letters[:count]
    raise ValueError(f"no representation for {count} letters")
