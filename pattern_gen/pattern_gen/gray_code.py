"""Binary code sequences in two directions, for the calibration of the projector (section III.B; Inokuchi).

Two arrangements of the code words over the columns (or rows):

- REFLECTED: consecutive words differ in one bit, the usual Gray code. Stripes are as wide as can be, so blur hurts
  least, and a wrong bit at a stripe's edge moves the decoded column by one.
- MAX_DISTANCE: consecutive words differ in n and n - 1 bits in turn, the greatest distances possible, as the paper's
  section III.B asks for: every other word is the complement of the one before. Neighbouring columns cannot be confused,
  but all frames have stripes of one pixel, which needs a sharp projector and a camera that resolves them.
"""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import NDArray

from pattern_gen.errors import ProjectionError


class Arrangement(Enum):
    """Order of the code words, see the module."""

    REFLECTED = "reflected"
    MAX_DISTANCE = "max_distance"


class Axis(Enum):
    """What the words count: columns (u) or rows (v) of the projector."""

    COLUMNS = "columns"
    ROWS = "rows"


def bit_count(length: int) -> int:
    """Number of bits, that is of frames without inverses, for `length` columns or rows."""
    return max(1, int(length - 1).bit_length())


def code_words(length: int, arrangement: Arrangement = Arrangement.REFLECTED) -> NDArray[np.int64]:
    """(length,) int64: the word of each column or row; frame 0 shows the most significant of its bit_count bits."""
    index = np.arange(length, dtype=np.int64)
    if arrangement is Arrangement.REFLECTED:
        return index ^ (index >> 1)
    half = (
        index >> 1
    )  # the pairs count through the reflected code of one bit less; the second of a pair is the complement
    words = half ^ (half >> 1)
    return np.where(index % 2 == 0, words, ~words & ((1 << bit_count(length)) - 1))


def decode_words(
    words: NDArray[np.int64], length: int, arrangement: Arrangement = Arrangement.REFLECTED
) -> NDArray[np.int64]:
    """Columns or rows of words, -1 where a word is not used. The inverse of code_words; any shape."""
    table = np.full(1 << bit_count(length), -1, dtype=np.int64)
    table[code_words(length, arrangement)] = np.arange(length)
    return table[words]


def code_frame(
    width: int,
    height: int,
    axis: Axis,
    bit: int,
    *,
    inverse: bool = False,
    arrangement: Arrangement = Arrangement.REFLECTED,
) -> NDArray[np.uint8]:
    """(height, width, 3) uint8: one bit of all words, white where it is set.

    Args:
        bit: 0 is the most significant.
        inverse: the complement, to compare with instead of a threshold.

    Raises:
        ProjectionError: the axis has no such bit.
    """
    length = width if axis is Axis.COLUMNS else height
    bits = bit_count(length)
    if not 0 <= bit < bits:
        raise ProjectionError(f"bit {bit} does not exist: the {length} {axis.value} take {bits} bits, 0 to {bits - 1}")
    line = (code_words(length, arrangement) >> (bits - 1 - bit)) & 1
    values = np.where(line.astype(bool) != inverse, 255, 0).astype(np.uint8)
    plane = values[None, :] if axis is Axis.COLUMNS else values[:, None]
    return np.repeat(np.broadcast_to(plane, (height, width))[..., None], 3, axis=2)
