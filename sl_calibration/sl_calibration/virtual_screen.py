"""The virtual projector screen for lens shift (Koninckx; section III.B).

The panel of most projectors is mounted off the lens's axis, so the principal point lies near the panel's edge or
outside it. A virtual screen is a larger panel, centred on the axis, of which the real one is a part: with height a on
one side of the central ray and b on the other, it is 2a / (a + b) times as high as the real one. A calibration that
wants the principal point near the middle of the image can start from it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_SHARES = (0.5, 0.8, 1.1, 1.4)


@dataclass(frozen=True)
class VirtualScreen:
    """A screen centred on the principal point that holds the panel.

    Attributes:
        width: Its width [px].
        height: Its height [px].
        left: Columns of the screen left of the panel [px].
        top: Rows of the screen above the panel [px].
        growth_x: Its width over the panel's.
        growth_y: Its height over the panel's: 2a / (a + b).
    """

    width: float
    height: float
    left: float
    top: float
    growth_x: float
    growth_y: float


def growth(larger: float, smaller: float) -> float:
    """Return 2a / (a + b): a on the larger side of the central ray, b on the other, negative when the ray is
    outside."""
    return 2 * larger / (larger + smaller)


def virtual_screen(width: int, height: int, center: Array) -> VirtualScreen:
    """Return the least screen that is centred on the principal point (cx, cy) [px] and holds the panel.

    Pixel centres are integers: the panel spans -0.5 to width - 0.5.
    """
    before = np.asarray(center, dtype=np.float64) + 0.5
    after = np.array([width, height]) - before
    larger = np.maximum(before, after)
    factors = [growth(float(a), float(b)) for a, b in zip(larger, np.minimum(before, after), strict=True)]
    return VirtualScreen(
        float(2 * larger[0]),
        float(2 * larger[1]),
        float(larger[0] - before[0]),
        float(larger[1] - before[1]),
        factors[0],
        factors[1],
    )


def starting_centers(width: int, height: int) -> list[tuple[float, float]]:
    """Return principal points to start from: no shift, and shifts down, up, right and left to beyond the panel's
    edge."""
    middle = ((width - 1) / 2, (height - 1) / 2)
    centers = [middle]
    for share in _SHARES[1:]:
        centers += [
            (middle[0], share * height - 0.5),
            (middle[0], (1 - share) * height - 0.5),
            (share * width - 0.5, middle[1]),
            ((1 - share) * width - 0.5, middle[1]),
        ]
    return centers
