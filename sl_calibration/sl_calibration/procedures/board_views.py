"""How well views of a chessboard cover what a calibration needs, and where to hold the board next."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from sl_calibration.chessboard import Board
from sl_calibration.motion_plan import Coverage

Array = NDArray[np.float64]

_COLUMNS, _ROWS = 16, 12
_NEEDED_TILT = np.radians(25.0)
_PLACES = (("upper left", "upper", "upper right"), ("left", "middle", "right"), ("lower left", "lower", "lower right"))


def board_coverage(
    corners: Sequence[Array], board: Board, size: tuple[int, int], *, needed: int, advised: int
) -> Coverage:
    """Measure views (N, 2 each) of a board's corners [px] in images of ``size`` (width, height).

    Tilt and distance come from the homography of each view with a focal length of the image's width: enough to say what
    is missing before anything is calibrated.
    """
    if not corners:
        return Coverage(0.0, 0.0, float("nan"), "no samples yet: hold the board into view and call ~/take_sample")
    pixels = np.concatenate(corners)
    pixels = pixels[np.isfinite(pixels).all(-1)]
    limits = ((-0.5, size[0] - 0.5), (-0.5, size[1] - 0.5))
    cells = np.histogram2d(pixels[:, 0], pixels[:, 1], bins=(_COLUMNS, _ROWS), range=limits)[0].T > 0
    poses = [pose for view in corners if (pose := _rough_pose(view, board, size)) is not None]
    normals = np.array([normal for normal, _ in poses]).reshape(-1, 3)
    cosine = np.abs(normals @ normals.T) if len(normals) else np.ones((1, 1))
    tilt = float(np.arccos(np.clip(cosine.min(), 0, 1)))
    distances = np.array([distance for _, distance in poses])
    depth = float(np.ptp(distances) / distances.mean()) if len(distances) else float("nan")
    parts = [f"{len(corners)} samples"]
    if len(corners) < needed:
        parts.append(f"at least {needed} are needed, {advised} advised")
    if len(corners) > 1 and tilt < _NEEDED_TILT:
        parts.append(
            f"the board is tilted by {np.degrees(tilt):.0f} deg between views at most: tilt it by 30 deg and more,"
            " about both of its axes"
        )
    elif cells.mean() < 0.6 and len(corners) > 1:
        parts.append(f"corners cover {100 * cells.mean():.0f} % of the image: hold the board {_emptiest(cells)} next")
    elif len(corners) >= advised:
        parts.append("enough: call ~/compute")
    return Coverage(float(cells.mean()), tilt, depth, "; ".join(parts))


def _rough_pose(corners: Array, board: Board, size: tuple[int, int]) -> tuple[Array, float] | None:
    """Return the board's normal (3,) and distance [m] in a camera of an ordinary focal length; None: not found."""
    seen = np.isfinite(corners).all(-1)
    if seen.sum() < 6:
        return None
    matrix = np.array([[size[0], 0, size[0] / 2], [0, size[0], size[1] / 2], [0, 0, 1.0]])
    ok, rotation, translation = cv2.solvePnP(board.points[seen], corners[seen], matrix, None)
    if not ok:
        return None
    return cv2.Rodrigues(rotation)[0][:, 2], float(np.linalg.norm(translation))


def _emptiest(cells: NDArray[np.bool_]) -> str:
    """Return the part of the image with the fewest corners, in words."""
    share = cells.reshape(3, _ROWS // 3, _COLUMNS)
    thirds = np.array([[block.mean() for block in np.array_split(row, 3, axis=1)] for row in share])
    row, column = np.unravel_index(int(np.argmin(thirds)), thirds.shape)
    return f"to the {_PLACES[row][column]} of the image" if (row, column) != (1, 1) else "to the middle of the image"
