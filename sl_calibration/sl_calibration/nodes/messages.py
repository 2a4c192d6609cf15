"""sl_msgs to and from the arrays of the core."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pattern_gen.pattern import Letter
from sl_calibration.sessions import SessionPattern
from sl_common.errors import InvalidInputError
from sl_msgs.msg import Correspondences, Pattern

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Dots:
    """Correspondences of one image, N dots.

    Attributes:
        camera: (N, 2) raw camera pixels.
        projector: (N, 2) projector pixels.
        row: (N,) int64.
        col: (N,) int64.
        confidence: (N,) 0..1.
        track_id: (N,) int64, -1: not tracked.
    """

    camera: Array
    projector: Array
    row: NDArray[np.int64]
    col: NDArray[np.int64]
    confidence: Array
    track_id: NDArray[np.int64]


def dots_from_message(message: Correspondences) -> Dots:
    """Return a message's dots; raises InvalidInputError when its arrays differ in length."""
    lengths = {
        name: len(getattr(message, name))
        for name in ("camera_u", "camera_v", "projector_u", "projector_v", "row", "col", "confidence")
    }
    if len(set(lengths.values())) > 1:
        raise InvalidInputError(f"correspondences with arrays of different length: {lengths}")
    count = lengths["row"]
    track_id = np.array(message.track_id, dtype=np.int64)
    return Dots(
        camera=np.stack([message.camera_u, message.camera_v], axis=-1).astype(np.float64).reshape(-1, 2),
        projector=np.stack([message.projector_u, message.projector_v], axis=-1).astype(np.float64).reshape(-1, 2),
        row=np.array(message.row, dtype=np.int64),
        col=np.array(message.col, dtype=np.int64),
        confidence=np.array(message.confidence, dtype=np.float64),
        track_id=track_id if len(track_id) == count else np.full(count, -1),
    )


def centers_from_message(message: Pattern) -> Array:
    """Return a pattern's spot centres (rows, cols, 2) [projector px]; raises InvalidInputError for a wrong size."""
    shape = (message.rows, message.cols)
    if len(message.center_u) != shape[0] * shape[1] or len(message.center_v) != shape[0] * shape[1]:
        raise InvalidInputError(
            f"pattern of {shape[0]}x{shape[1]} with {len(message.center_u)}, {len(message.center_v)} centre coordinates"
        )
    centers = np.stack([message.center_u, message.center_v], axis=-1).astype(np.float64)
    return centers.reshape(*shape, 2)


def session_pattern(message: Pattern) -> SessionPattern:
    """Return what a calibration session needs of a pattern; raises StructuredLightError for a wrong message."""
    letters = tuple(
        Letter((int(letter.rgb[0]), int(letter.rgb[1]), int(letter.rgb[2])), letter.shape) for letter in message.letters
    )
    return SessionPattern(
        message.pattern_id,
        centers_from_message(message),
        (message.projector_width, message.projector_height),
        message.spot_diameter,
        letters,
    )


def colours_from_message(message: Pattern) -> NDArray[np.uint8]:
    """Return a pattern's drive colours (rows, cols, 3) uint8 RGB; raises InvalidInputError for bad symbols."""
    symbols = np.array(message.symbols, dtype=np.int64)
    if symbols.size != message.rows * message.cols:
        raise InvalidInputError(f"pattern of {message.rows}x{message.cols} with {symbols.size} symbols")
    palette = np.array([letter.rgb for letter in message.letters], dtype=np.uint8).reshape(-1, 3)
    if symbols.size and symbols.max() >= len(palette):
        raise InvalidInputError(f"pattern with symbol {symbols.max()} but {len(palette)} letters")
    return palette[symbols].reshape(message.rows, message.cols, 3)
