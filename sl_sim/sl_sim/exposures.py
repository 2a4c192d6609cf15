"""What is asked of the simulated camera and what comes back."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Exposure:
    """One image to take.

    Attributes:
        stamp: [ns], the middle of the exposure. positions: (k, 6) true joints at k instants spread evenly over the
            exposure.
        base_from_object: the object's pose at the stamp.
        projector_bgr: (H, W, 3) uint8, what the projector shows from now on; None = as before.
    """

    stamp: int
    positions: np.ndarray
    base_from_object: np.ndarray
    projector_bgr: np.ndarray | None = None


@dataclass(frozen=True)
class Taken:
    """An image (H, W, 3) uint8 BGR with the true pose base_from_camera (4, 4) at its stamp [ns] and the exposure
    gain used.
    """

    stamp: int
    image: np.ndarray
    base_from_camera: np.ndarray
    base_from_object: np.ndarray
    exposure: float
