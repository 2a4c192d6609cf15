"""colours.yaml: the drive values of the letters that a colour calibration found."""

from __future__ import annotations

from pathlib import Path

from pattern_gen.errors import PatternError
from pattern_gen.pattern import Letter, Pattern
from sl_common.files import read_yaml


def with_calibrated_colours(pattern: Pattern, path: str | Path) -> Pattern:
    """The pattern with its letters' rgb replaced by those of colours.yaml: `letters: [{rgb: [r, g, b], ...}, ...]`.

    Raises:
        PatternError: the file does not fit the pattern.
        CalibrationFileError: it cannot be read.
    """
    entries = read_yaml(path).get("letters")
    if not isinstance(entries, list) or len(entries) != pattern.alphabet:
        found = f"{len(entries)} letters" if isinstance(entries, list) else "no list `letters`"
        raise PatternError(
            f"{path}: {found}, the pattern has {pattern.alphabet}; calibrate the colours with this pattern"
        )
    letters: list[Letter] = []
    for number, (entry, letter) in enumerate(zip(entries, pattern.letters, strict=True)):
        rgb = entry.get("rgb") if isinstance(entry, dict) else None
        if not (isinstance(rgb, list) and len(rgb) == 3 and all(isinstance(value, int | float) for value in rgb)):
            raise PatternError(f"{path}: letter {number} lacks rgb: [r, g, b], the projector's drive values 0..255")
        try:
            letters.append(Letter((round(rgb[0]), round(rgb[1]), round(rgb[2])), letter.shape))
        except PatternError as error:
            raise PatternError(f"{path}: letter {number}: {error}") from None
    return pattern.with_letters(tuple(letters))
