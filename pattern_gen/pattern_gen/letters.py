"""Representations of letters: colours, intensities, shapes and their combinations (Morano's separation; section II)."""

from __future__ import annotations

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
