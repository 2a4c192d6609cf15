"""Reading image files as the decoder wants them: BGR, eight bits; PNG, JPEG, TIFF, 8 and 16 bit, Bayer on request."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from sl_common.errors import InvalidInputError

BAYER = {
    "rggb": cv2.COLOR_BayerBG2BGR,  # OpenCV names the pattern after its second row's second and third pixel
    "bggr": cv2.COLOR_BayerRG2BGR,
    "gbrg": cv2.COLOR_BayerGR2BGR,
    "grbg": cv2.COLOR_BayerGB2BGR,
}
BRIGHT_PERCENTILE = 99.9  # of a 16-bit image: becomes 255


def to_eight_bits(image: NDArray) -> NDArray[np.uint8]:
    """Scale an image of 16 bits (or float) so that its bright end fills eight bits; 8-bit images pass unchanged.

    Linear sensor data lose their dark letters when their upper eight bits are cut off; so the scale follows the image.
    """
    if image.dtype == np.uint8:
        return image
    values = image.astype(np.float32)
    top = float(np.percentile(values, BRIGHT_PERCENTILE))
    if not np.isfinite(top) or top <= 0:
        return np.zeros(image.shape, np.uint8)
    return np.clip(values * (255.0 / top) + 0.5, 0, 255).astype(np.uint8)


def read_image(path: str | Path, *, bayer: str | None = None) -> NDArray[np.uint8]:
    """Read an image file as (H, W, 3) uint8 BGR.

    bayer: the mosaic of a raw single-channel image, a key of BAYER; None: the file holds colours (or grey values).
    Raises InvalidInputError when the file is missing, no image, or does not fit the request.
    """
    path = Path(path)
    if not path.is_file():
        raise InvalidInputError(f"{path}: no such file")
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise InvalidInputError(f"{path}: not a readable image; use PNG, JPEG or TIFF")
    if bayer is not None:
        if image.ndim != 2:
            raise InvalidInputError(f"{path}: --bayer {bayer} needs one channel, the file has {image.shape[2]}")
        return to_eight_bits(cv2.cvtColor(image, BAYER[bayer]))
    if image.ndim == 2:
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    elif image.shape[2] == 4:
        image = image[:, :, :3]
    elif image.shape[2] != 3:
        raise InvalidInputError(f"{path}: {image.shape[2]} channels; expected grey, colour or colour with alpha")
    return np.ascontiguousarray(to_eight_bits(image))
