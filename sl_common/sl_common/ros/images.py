"""sensor_msgs/Image to and from OpenCV arrays, honouring encoding, step and endianness."""

import array
import sys

import cv2
import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from sl_common.errors import InvalidInputError

_CHANNELS = {
    "bgr8": 3,
    "rgb8": 3,
    "bgra8": 4,
    "rgba8": 4,
    "mono8": 1,
    "8UC1": 1,
    "8UC3": 3,
    "mono16": 1,
    "16UC1": 1,
    "bgr16": 3,
    "rgb16": 3,
    "bayer_rggb8": 1,
    "bayer_bggr8": 1,
    "bayer_gbrg8": 1,
    "bayer_grbg8": 1,
    "bayer_rggb16": 1,
    "bayer_bggr16": 1,
    "bayer_gbrg16": 1,
    "bayer_grbg16": 1,
}
# OpenCV names a Bayer pattern by its second row's second and third pixel: ROS' rggb is OpenCV's BG.
_BAYER = {
    "rggb": cv2.COLOR_BayerBG2BGR,
    "bggr": cv2.COLOR_BayerRG2BGR,
    "gbrg": cv2.COLOR_BayerGR2BGR,
    "grbg": cv2.COLOR_BayerGB2BGR,
}


def to_bgr(message: Image) -> NDArray[np.uint8]:
    """Return an image message as (H, W, 3) uint8 BGR; 16-bit images keep their upper eight bits.

    A bgr8 image is a read-only view of the message's own bytes where its step allows. Raises InvalidInputError for an
    empty image, an encoding that is not supported, or a step or size that does not fit.
    """
    encoding = message.encoding
    if encoding not in _CHANNELS:
        raise InvalidInputError(f"image encoding '{encoding}' is not supported; use one of {', '.join(_CHANNELS)}")
    if message.width == 0 or message.height == 0:
        raise InvalidInputError(f"image is empty: {message.width}x{message.height}")
    channels = _CHANNELS[encoding]
    sixteen = encoding.endswith("16") or encoding.startswith("16")
    row_bytes = message.width * channels * (2 if sixteen else 1)
    if message.step < row_bytes:
        raise InvalidInputError(
            f"image step is {message.step} bytes, but {message.width} pixels of {encoding} take {row_bytes}"
        )
    needed = message.step * (message.height - 1) + row_bytes
    if len(message.data) < needed:
        raise InvalidInputError(
            f"image data has {len(message.data)} bytes, but {message.width}x{message.height} {encoding} with step "
            f"{message.step} takes {message.step * message.height}"
        )
    raw = np.frombuffer(message.data, dtype=np.uint8, count=needed)
    rows = np.lib.stride_tricks.as_strided(raw, (message.height, row_bytes), (message.step, 1), writeable=False)
    if sixteen:
        # The more significant byte of each pair is the image in eight bits.
        rows = rows[:, 0 if message.is_bigendian else 1 :: 2]
    pixels = rows.reshape(message.height, message.width, channels)
    return _to_bgr8(pixels, encoding)


def _to_bgr8(pixels: NDArray[np.uint8], encoding: str) -> NDArray[np.uint8]:
    if encoding in ("bgr8", "8UC3"):
        return pixels
    pixels = np.ascontiguousarray(pixels)
    if encoding.startswith("bayer"):
        return cv2.cvtColor(pixels, _BAYER[encoding[6:10]])
    if encoding.startswith("rgba"):
        return cv2.cvtColor(pixels, cv2.COLOR_RGBA2BGR)
    if encoding.startswith("bgra"):
        return cv2.cvtColor(pixels, cv2.COLOR_BGRA2BGR)
    if encoding.startswith("rgb"):
        return cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR)
    if encoding.startswith("bgr"):
        return pixels
    return cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR)


def to_message(image: NDArray[np.uint8], header: Header, encoding: str = "bgr8") -> Image:
    """Return an (H, W, 3) or (H, W) uint8 array as a message of the given encoding (the bytes are not converted)."""
    image = np.ascontiguousarray(image, dtype=np.uint8)
    channels = 1 if image.ndim == 2 else image.shape[2]
    if _CHANNELS.get(encoding) != channels:
        raise InvalidInputError(f"{channels} channels do not fit encoding '{encoding}'")
    data = array.array("B")
    data.frombytes(image.data)  # assigning an array('B') is the one fast way into Image.data
    return Image(
        header=header,
        height=image.shape[0],
        width=image.shape[1],
        encoding=encoding,
        is_bigendian=int(sys.byteorder == "big"),
        step=image.shape[1] * channels,
        data=data,
    )
