"""Decoded to sl_msgs/Correspondences."""

from __future__ import annotations

import array

import numpy as np
from std_msgs.msg import Header

from sl_decoder.decoded import Decoded
from sl_msgs.msg import Correspondences


def _packed(code: str, values: np.ndarray, dtype: type) -> array.array:
    packed = array.array(code)
    packed.frombytes(np.ascontiguousarray(values, dtype=dtype).tobytes())
    return packed


def to_message(decoded: Decoded, header: Header, pattern_id: str) -> Correspondences:
    """The message of a decoded image; header is the image's."""
    message = Correspondences()
    message.header = header
    message.pattern_id = pattern_id
    message.camera_u = _packed("f", decoded.camera[:, 0], np.float32)
    message.camera_v = _packed("f", decoded.camera[:, 1], np.float32)
    message.projector_u = _packed("f", decoded.projector[:, 0], np.float32)
    message.projector_v = _packed("f", decoded.projector[:, 1], np.float32)
    message.row = _packed("H", decoded.row, np.uint16)
    message.col = _packed("H", decoded.col, np.uint16)
    message.confidence = _packed("f", decoded.confidence, np.float32)
    message.corrected = _packed("B", decoded.corrected, np.uint8)
    message.track_id = _packed("i", decoded.track_id, np.int32)
    message.blobs = decoded.blobs
    message.labelled = decoded.labelled
    message.inconsistent = decoded.inconsistent
    message.rejected = decoded.rejected
    message.decode_time = float(decoded.decode_time)
    return message
