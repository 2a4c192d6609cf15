"""The pattern: a map of letters, their representation, and where each spot lies in the projector image.

Pixel centres are integers: the centre of the top-left projector pixel is (0, 0). Paper, section II.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pattern_gen.errors import PatternError
from pattern_gen.rendering import render_spots
from pattern_gen.shapes import SHAPES

MAX_ALPHABET = 36  # one base-36 digit a letter in the pattern file
HEXAGONAL_COLUMN_PITCH = np.sqrt(3.0) / 2.0  # column distance over row distance, paper section II.D


class Grid(Enum):
    """How the spots are arranged. SQUARE: four orientations; HEXAGONAL: odd columns half a row lower, six."""

    SQUARE = "square"
    HEXAGONAL = "hexagonal"

    @property
    def orientations(self) -> int:
        """Number of rotations that map the grid onto itself about a spot."""
        return 4 if self is Grid.SQUARE else 6


@dataclass(frozen=True)
class Letter:
    """How the projector represents one letter (Morano's separation of letter and representation).

    Attributes:
        rgb: drive values of the projector, red green blue, 0..255.
        shape: one of `pattern_gen.shapes.SHAPES`.
    """

    rgb: tuple[int, int, int]
    shape: str = "disc"

    def __post_init__(self) -> None:
        if len(self.rgb) != 3 or any(int(value) != value or not 0 <= value <= 255 for value in self.rgb):
            raise PatternError(f"rgb={list(self.rgb)} must be three integers from 0 to 255")
        if max(self.rgb) == 0:
            raise PatternError("rgb=[0, 0, 0] is black: the letter could not be seen")
        if self.shape not in SHAPES:
            raise PatternError(f"unknown shape {self.shape!r}; known: {', '.join(SHAPES)}")
        object.__setattr__(self, "rgb", tuple(int(value) for value in self.rgb))


@dataclass(frozen=True, eq=False)
class Pattern:
    """A map of letters as the projector shows it.

    Attributes:
        grid: arrangement of the spots.
        symbols: (rows, cols) uint8, index into `letters`; made read-only.
        letters: the alphabet, one representation a letter.
        window: window size w, odd; 3: 3x3 spots, or a hexagon with its centre.
        min_hamming: least number of differing spots between any two windows over all rotations.
        projector_width, projector_height: size of the projector image in [px].
        pitch: distance of the rows (and of the columns of a square grid) in projector [px].
        origin: (u0, v0), centre of spot (0, 0) in projector [px].
        spot_diameter: diameter of the spots in projector [px].

    Raises:
        PatternError: values that contradict each other, with the numbers.
    """

    grid: Grid
    symbols: NDArray[np.uint8]
    letters: tuple[Letter, ...]
    window: int = 3
    min_hamming: int = 1
    projector_width: int = 1024
    projector_height: int = 768
    pitch: float = 17.0
    origin: tuple[float, float] = (27.0, 18.0)
    spot_diameter: float = field(default=8.0)

    def __post_init__(self) -> None:
        symbols = np.array(self.symbols, dtype=np.uint8)
        symbols.setflags(write=False)
        object.__setattr__(self, "symbols", symbols)
        object.__setattr__(self, "letters", tuple(self.letters))
        object.__setattr__(self, "origin", (float(self.origin[0]), float(self.origin[1])))
        if symbols.ndim != 2:
            raise PatternError(f"symbols must be a (rows, cols) array, not of shape {symbols.shape}")
        if not 2 <= len(self.letters) <= MAX_ALPHABET:
            raise PatternError(f"{len(self.letters)} letters; an alphabet has 2 to {MAX_ALPHABET}")
        if len(set(self.letters)) < len(self.letters):
            raise PatternError("two letters have the same representation: the camera could not tell them apart")
        if self.window < 3 or self.window % 2 == 0:
            raise PatternError(f"window={self.window} must be odd and at least 3, so that a spot lies in its middle")
        if min(symbols.shape) < self.window:
            raise PatternError(f"a map of {self.rows}x{self.cols} holds no {self.window}x{self.window} window")
        if symbols.size and symbols.max() >= len(self.letters):
            row, col = np.unravel_index(int(symbols.argmax()), symbols.shape)
            raise PatternError(
                f"symbol {symbols.max()} at row {row}, column {col} has no letter: the alphabet has {len(self.letters)}"
            )
        if self.min_hamming < 1:
            raise PatternError(f"min_hamming={self.min_hamming} must be at least 1")
        self._check_geometry()

    def _check_geometry(self) -> None:
        if self.projector_width < 1 or self.projector_height < 1:
            raise PatternError(f"projector size {self.projector_width}x{self.projector_height} must be positive")
        for name, value in (("pitch", self.pitch), ("spot_diameter", self.spot_diameter)):
            if not (np.isfinite(value) and value > 0):
                raise PatternError(f"{name}={value} must be a positive number of pixels")
        if not np.isfinite(self.origin).all():
            raise PatternError(f"origin={list(self.origin)} must be two finite numbers")
        for spot in ((0, 0), (0, -1), (-1, 0), (-1, -1), (-1, 1)):
            u, v = self.centers[spot]
            if not (-0.5 <= u <= self.projector_width - 0.5 and -0.5 <= v <= self.projector_height - 0.5):
                row, col = range(self.rows)[spot[0]], range(self.cols)[spot[1]]
                raise PatternError(
                    f"spot ({row}, {col}) at ({u:.1f}, {v:.1f}) lies outside the projector image of "
                    f"{self.projector_width}x{self.projector_height}; reduce the pitch or move the origin"
                )

    @property
    def rows(self) -> int:
        """Number of rows."""
        return int(self.symbols.shape[0])

    @property
    def cols(self) -> int:
        """Number of columns."""
        return int(self.symbols.shape[1])

    @property
    def alphabet(self) -> int:
        """Number of letters."""
        return len(self.letters)

    @property
    def window_count(self) -> int:
        """Number of windows, that is of spots that carry a code."""
        return (self.rows - self.window + 1) * (self.cols - self.window + 1)

    @cached_property
    def pattern_id(self) -> str:
        """Content hash of grid, window, min_hamming, symbols and letters, not of spot size or projector."""
        digest = hashlib.sha256()
        letters = ";".join(f"{r},{g},{b},{letter.shape}" for letter in self.letters for r, g, b in (letter.rgb,))
        head = f"{self.grid.value}|{self.window}|{self.min_hamming}|{self.rows}x{self.cols}|{letters}|"
        digest.update(head.encode())
        digest.update(np.ascontiguousarray(self.symbols).tobytes())
        return digest.hexdigest()[:16]

    @cached_property
    def centers(self) -> NDArray[np.float64]:
        """(rows, cols, 2) float64: spot centres (u, v) in projector [px]; read-only."""
        row, col = np.arange(self.rows)[:, None], np.arange(self.cols)
        u0, v0 = self.origin
        square = self.grid is Grid.SQUARE
        centers = np.empty((self.rows, self.cols, 2))
        centers[..., 0] = u0 + (self.pitch if square else self.pitch * HEXAGONAL_COLUMN_PITCH) * col
        centers[..., 1] = v0 + self.pitch * (row if square else row + 0.5 * (col % 2))
        centers.setflags(write=False)
        return centers

    def with_spot_diameter(self, spot_diameter: float) -> Pattern:
        """The same pattern (same pattern_id) with spots of another diameter in projector [px]."""
        return replace(self, spot_diameter=float(spot_diameter))

    def with_letters(self, letters: tuple[Letter, ...]) -> Pattern:
        """The same map with other representations of its letters; the pattern_id changes."""
        return replace(self, letters=letters)

    def render(self, spot_diameter: float | None = None) -> NDArray[np.uint8]:
        """(H, W, 3) uint8 RGB image of the projector, spots antialiased at their exact sub-pixel centres on black.

        Args:
            spot_diameter: another diameter in projector [px]; None: the pattern's own.
        """
        diameter = self.spot_diameter if spot_diameter is None else float(spot_diameter)
        if not (np.isfinite(diameter) and diameter > 0):
            raise PatternError(f"spot_diameter={diameter} must be a positive number of pixels")
        symbols = self.symbols.reshape(-1)
        return render_spots(
            self.projector_width,
            self.projector_height,
            self.centers.reshape(-1, 2),
            np.array([letter.rgb for letter in self.letters], dtype=np.float64)[symbols],
            np.array([letter.shape for letter in self.letters])[symbols],
            diameter,
        )

    @classmethod
    def load(cls, path: str | Path) -> Pattern:
        """Read a pattern file (YAML). Raises PatternFileError with the line and the reason."""
        from pattern_gen.pattern_file import load_pattern

        return load_pattern(path)

    def save(self, path: str | Path) -> None:
        """Write the pattern file (YAML), atomically."""
        from pattern_gen.pattern_file import save_pattern

        save_pattern(self, path)


def fit_to_projector(
    symbols: NDArray[np.uint8],
    letters: tuple[Letter, ...],
    *,
    grid: Grid = Grid.SQUARE,
    window: int = 3,
    min_hamming: int = 1,
    projector_width: int = 1024,
    projector_height: int = 768,
    spot_fraction: float = 0.47,
) -> Pattern:
    """The pattern that shows a map as large as the projector allows, centred, each spot with half a pitch of margin.

    The pitch is rounded down to whole pixels from 8 px on: then all spots of a square grid look exactly alike.

    Args:
        symbols: (rows, cols) map.
        letters: the alphabet.
        spot_fraction: spot diameter over pitch; the rest is the dark gap that separates the blobs.
    """
    rows, cols = np.shape(symbols)
    if grid is Grid.SQUARE:
        wide, high = cols - 1.0, rows - 1.0
    else:
        wide, high = (cols - 1) * HEXAGONAL_COLUMN_PITCH, rows - 1.0 + (0.5 if cols > 1 else 0.0)
    pitch = min(projector_width / (wide + 1.0), projector_height / (high + 1.0))
    pitch = float(np.floor(pitch)) if pitch >= 8.0 else float(np.floor(pitch * 1e4) / 1e4)
    diameter = spot_fraction * pitch
    return Pattern(
        grid=grid,
        symbols=symbols,
        letters=letters,
        window=window,
        min_hamming=min_hamming,
        projector_width=projector_width,
        projector_height=projector_height,
        pitch=pitch,
        origin=(
            round((projector_width - 1 - pitch * wide) / 2.0, 3),
            round((projector_height - 1 - pitch * high) / 2.0, 3),
        ),
        spot_diameter=float(np.round(diameter, 0 if diameter >= 6 else 4)),
    )
