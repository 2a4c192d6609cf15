"""The debug image: dots, graph, letters, rows and columns, and why the others were not decoded."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pattern_gen import Pattern
from sl_decoder.decoded import REASON_TEXT, Decoded, Reason

_REASON_COLOUR = {
    Reason.SATURATED: (255, 255, 255),
    Reason.TOO_SMALL: (170, 170, 170),
    Reason.NO_NEIGHBOURS: (255, 255, 0),
    Reason.INCONSISTENT: (0, 140, 255),
    Reason.UNKNOWN_CODE: (0, 255, 255),
    Reason.IMPROBABLE: (255, 0, 255),
    Reason.MIRRORED: (255, 128, 128),
}
_SHIFT = 4  # fractional bits of OpenCV's drawing coordinates


def _fixed(points: NDArray[np.float32], scale: int) -> NDArray[np.int32]:
    return np.round(((points + 0.5) * scale - 0.5) * (1 << _SHIFT)).astype(np.int32)


def draw(
    bgr: NDArray[np.uint8], decoded: Decoded, pattern: Pattern, *, scale: int = 2, label_every: int = 4
) -> NDArray[np.uint8]:
    """Overlay (H * scale, W * scale, 3) uint8 BGR of a decoded image.

    Lattice links between decoded dots are thin lines, every decoded dot a ring in its letter's colour (a square when
    its letter was corrected), every `label_every`-th row and column is labelled "row,col"; undecoded blobs are
    crosses in a colour per reason, with the legend and the counts below.
    """
    canvas = cv2.resize(bgr, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
    canvas = (canvas * 0.6).astype(np.uint8)
    index = np.full((pattern.rows, pattern.cols), -1, np.int32)
    index[decoded.row, decoded.col] = np.arange(len(decoded))
    at = _fixed(decoded.camera, scale)
    segments = []
    for dr, dc in ((0, 1), (1, 0)):
        a = index[: pattern.rows - dr, : pattern.cols - dc]
        b = index[dr:, dc:]
        both = (a >= 0) & (b >= 0)
        segments += [np.stack([at[i], at[j]]) for i, j in zip(a[both], b[both], strict=True)]
    if segments:
        cv2.polylines(canvas, segments, False, (90, 90, 90), 1, cv2.LINE_AA, _SHIFT)
    spacing = _spacing(decoded, index)
    radius = max(2.0, 0.33 * spacing) * scale
    for i, (x, y) in enumerate(at):
        letter = pattern.letters[pattern.symbols[decoded.row[i], decoded.col[i]]]
        colour = tuple(int(c) for c in letter.rgb[::-1])
        if decoded.corrected[i]:
            r = int(radius * (1 << _SHIFT))
            cv2.rectangle(canvas, (int(x) - r, int(y) - r), (int(x) + r, int(y) + r), colour, 1, cv2.LINE_AA, _SHIFT)
        else:
            cv2.circle(canvas, (int(x), int(y)), int(radius * (1 << _SHIFT)), colour, 1, cv2.LINE_AA, _SHIFT)
        if decoded.row[i] % label_every == 0 and decoded.col[i] % label_every == 0:
            text = f"{decoded.row[i]},{decoded.col[i]}"
            origin = ((int(x) >> _SHIFT) + 3, (int(y) >> _SHIFT) - 3)
            cv2.putText(canvas, text, origin, cv2.FONT_HERSHEY_PLAIN, 0.7, (255, 255, 255), 1, cv2.LINE_AA)
    inspection = decoded.inspection
    for reason, colour in _REASON_COLOUR.items():
        for x, y in _fixed(inspection.centre[inspection.reason == reason], scale) >> _SHIFT:
            cv2.drawMarker(canvas, (int(x), int(y)), colour, cv2.MARKER_TILTED_CROSS, 3 * scale, 1, cv2.LINE_AA)
    return np.vstack([canvas, _legend(canvas.shape[1], decoded)])


def _spacing(decoded: Decoded, index: NDArray[np.int32]) -> float:
    a, b = index[:, :-1], index[:, 1:]
    both = (a >= 0) & (b >= 0)
    if not both.any():
        return 8.0
    return float(np.median(np.linalg.norm(decoded.camera[a[both]] - decoded.camera[b[both]], axis=1)))


def _legend(width: int, decoded: Decoded) -> NDArray[np.uint8]:
    line = 18
    entries = [
        (f"{len(decoded)} decoded of {decoded.blobs} blobs, {1e3 * decoded.decode_time:.1f} ms", (255, 255, 255))
    ]
    if decoded.mirrored:
        entries.append(("seen in a mirror: refused", (128, 128, 255)))
    number = np.bincount(decoded.inspection.reason, minlength=len(Reason))
    entries += [(f"{REASON_TEXT[r]}: {number[r]}", colour) for r, colour in _REASON_COLOUR.items() if number[r]]
    x, y, placed = 6, line - 5, []
    for text, colour in entries:
        size = cv2.getTextSize(text, cv2.FONT_HERSHEY_PLAIN, 0.9, 1)[0][0]
        if x > 6 and x + size > width - 6:
            x, y = 6, y + line
        placed.append((text, (x, y), colour))
        x += size + 16
    legend = np.zeros((y + 8, width, 3), np.uint8)
    for text, origin, colour in placed:
        cv2.putText(legend, text, origin, cv2.FONT_HERSHEY_PLAIN, 0.9, colour, 1, cv2.LINE_AA)
    return legend
