"""Pattern to and from sl_msgs/Pattern."""

from __future__ import annotations

import array

import numpy as np
from std_msgs.msg import Header

from pattern_gen.errors import PatternError
from pattern_gen.pattern import HEXAGONAL_COLUMN_PITCH, Grid, Letter, Pattern
from sl_msgs.msg import Letter as LetterMessage
from sl_msgs.msg import Pattern as PatternMessage

_GRIDS = {Grid.SQUARE: PatternMessage.SQUARE, Grid.HEXAGONAL: PatternMessage.HEXAGONAL}
_CENTER_TOLERANCE = 0.01  # [px]; centres travel as float32


def pattern_to_message(pattern: Pattern, header: Header) -> PatternMessage:
    """The message of a pattern; header.frame_id is the projector's optical frame."""
    message = PatternMessage()
    message.header = header
    message.pattern_id = pattern.pattern_id
    message.grid = _GRIDS[pattern.grid]
    message.window = pattern.window
    message.min_hamming = pattern.min_hamming
    message.rows = pattern.rows
    message.cols = pattern.cols
    message.symbols = array.array("B", pattern.symbols.tobytes())
    centers = pattern.centers.astype(np.float32)
    message.center_u = array.array("f", centers[..., 0].tobytes())
    message.center_v = array.array("f", centers[..., 1].tobytes())
    message.spot_diameter = float(pattern.spot_diameter)
    message.letters = [
        LetterMessage(shape=letter.shape, rgb=np.array(letter.rgb, dtype=np.uint8)) for letter in pattern.letters
    ]
    message.projector_width = pattern.projector_width
    message.projector_height = pattern.projector_height
    return message


def pattern_from_message(message: PatternMessage) -> Pattern:
    """The pattern of a message.

    Raises:
        PatternError: lengths that do not fit rows and cols, an unknown grid, centres off the grid, or a pattern_id that
            does not belong to the contents.
    """
    kinds = {value: grid for grid, value in _GRIDS.items()}
    if message.grid not in kinds:
        raise PatternError(f"pattern message: unknown grid {message.grid}, known: 0 (square), 1 (hexagonal)")
    count = message.rows * message.cols
    for name in ("symbols", "center_u", "center_v"):
        if len(getattr(message, name)) != count or count == 0:
            raise PatternError(
                f"pattern message: {name} has {len(getattr(message, name))} values, "
                f"{message.rows}x{message.cols} needs {count}"
            )
    grid = kinds[message.grid]
    shape = (message.rows, message.cols)
    centers = np.stack([np.array(message.center_u), np.array(message.center_v)], axis=-1).astype(np.float64)
    centers = centers.reshape(*shape, 2)
    if min(shape) < 2:
        raise PatternError(f"pattern message: {message.rows}x{message.cols} spots hold no window")
    # float32 on the wire: the pitch over the whole height is exact to a few 1e-6 px
    pitch = float(np.round((centers[-1, 0, 1] - centers[0, 0, 1]) / (message.rows - 1), 6))
    pattern = Pattern(
        grid=grid,
        symbols=np.array(message.symbols, dtype=np.uint8).reshape(shape),
        letters=tuple(
            Letter((int(letter.rgb[0]), int(letter.rgb[1]), int(letter.rgb[2])), letter.shape)
            for letter in message.letters
        ),
        window=message.window,
        min_hamming=message.min_hamming,
        projector_width=message.projector_width,
        projector_height=message.projector_height,
        pitch=pitch,
        origin=(float(centers[0, 0, 0]), float(centers[0, 0, 1])),
        spot_diameter=float(message.spot_diameter),
    )
    worst = float(np.abs(pattern.centers - centers).max())
    if worst > _CENTER_TOLERANCE:
        step = pitch * (1.0 if grid is Grid.SQUARE else HEXAGONAL_COLUMN_PITCH)
        raise PatternError(
            f"pattern message: centres lie up to {worst:.3f} px off a {grid.value} grid "
            f"of column distance {step:.3f} px"
        )
    if message.pattern_id != pattern.pattern_id:
        raise PatternError(
            f"pattern message: pattern_id {message.pattern_id!r} does not belong to its contents ({pattern.pattern_id})"
        )
    return pattern
