"""Chessboards: their geometry and the detection of their inner corners, at any resolution.

Corners are found by OpenCV's sector-based detector (Duda and Frese 2018), at more than one scale, with the older
detector behind it. It takes a board for what it is, not for a part of it: a wrong size is told by what was found.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]

_SCALES = (1.0, 0.5, 2.0)
_MAX_PIXELS = 3e6
_LARGEST_SQUARE = 1.0


class BoardNotFoundError(InvalidInputError):
    """The board was not found in an image.

    Attributes:
        found: (columns, rows) of inner corners of another board, or part of one, that was found; None: nothing.
    """

    def __init__(self, message: str, found: tuple[int, int] | None = None):
        super().__init__(message)
        self.found = found


@dataclass(frozen=True)
class Board:
    """A chessboard.

    Attributes:
        columns: Inner corners along its x axis.
        rows: Inner corners along its y axis.
        square: Side of a square [m].
    """

    columns: int
    rows: int
    square: float

    def __post_init__(self) -> None:
        if self.columns < 3 or self.rows < 3:
            raise InvalidInputError(f"board {self.columns}x{self.rows}: at least 3x3 inner corners are needed")
        if not (np.isfinite(self.square) and self.square > 0):
            raise InvalidInputError(f"square {self.square:g}: the side of a square must be positive, in metres")
        if self.square > _LARGEST_SQUARE:
            raise InvalidInputError(
                f"square {self.square:g} m is too large for a calibration board: mixed units? Give it in metres,"
                f" {self.square / 1000:g} if {self.square:g} are millimetres"
            )

    @property
    def points(self) -> Array:
        """(rows * columns, 3) float64 corners in the board's frame [m], row by row, z = 0 (z points into the board)."""
        y, x = np.mgrid[: self.rows, : self.columns]
        return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=-1) * self.square

    def __str__(self) -> str:
        return f"{self.columns}x{self.rows}"


def parse_size(text: str, what: str = "size") -> tuple[int, int]:
    """Read ``8x6`` as (8, 6). Raises InvalidInputError."""
    parts = text.lower().split("x")
    try:
        first, second = (int(part) for part in parts)
    except ValueError:
        raise InvalidInputError(f"{what} '{text}': expected two whole numbers such as 9x7") from None
    if first < 1 or second < 1:
        raise InvalidInputError(f"{what} '{text}': both numbers must be positive")
    return first, second


def detect_corners(image: NDArray[np.uint8], board: Board) -> Array:
    """Find the inner corners of a chessboard.

    Args:
        image: (H, W) or (H, W, 3) BGR, uint8.
        board: The board; its columns and rows may be given in either order, the result follows ``board``.

    Returns:
        (rows * columns, 2) float64 pixels in the order of ``board.points``, right-handed (x along the columns, y along
        the rows, z into the board). Where a half turn maps the board onto itself, its x axis points to the right.

    Raises:
        BoardNotFoundError: with the size that was found instead, if any.
    """
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    size = (board.columns, board.rows)
    for scale in _SCALES:
        if gray.size * scale**2 > _MAX_PIXELS and scale > 1:
            continue
        corners = _sector_based(gray, size, scale)
        if corners is not None and _is_board(gray, corners, board):
            return _oriented(corners, board)
    found = _any_board(gray)
    if found is None or min(found) < 4 or sorted(found) == sorted(size):
        corners = _older_detector(gray, size)
        if corners is not None and _is_board(gray, corners, board):
            return _oriented(corners, board)
    if found is None:
        raise BoardNotFoundError(f"no chessboard of {board} inner corners found")
    raise BoardNotFoundError(f"no chessboard of {board} inner corners found, but one of {found[0]}x{found[1]}", found)


def spacing(corners: Array, board: Board) -> Array:
    """Return each corner's least distance [px] to its neighbours along rows and columns, (rows * columns,) float64."""
    grid = corners.reshape(board.rows, board.columns, 2)
    across = np.linalg.norm(np.diff(grid, axis=1), axis=-1)
    down = np.linalg.norm(np.diff(grid, axis=0), axis=-1)
    least = np.full((board.rows, board.columns), np.inf)
    least[:, :-1] = np.minimum(least[:, :-1], across)
    least[:, 1:] = np.minimum(least[:, 1:], across)
    least[:-1] = np.minimum(least[:-1], down)
    least[1:] = np.minimum(least[1:], down)
    return least.ravel()


def _sector_based(gray: NDArray[np.uint8], size: tuple[int, int], scale: float) -> Array | None:
    image = gray if scale == 1 else cv2.resize(gray, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    flags = cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE
    ok, corners = cv2.findChessboardCornersSB(image, size, flags=flags)
    if not ok or corners is None or len(corners) != size[0] * size[1]:
        return None
    found = (corners.reshape(-1, 2).astype(np.float64) + 0.5) / scale - 0.5
    return found if scale >= 1 else _refined(gray, found, size)


def _older_detector(gray: NDArray[np.uint8], size: tuple[int, int]) -> Array | None:
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    ok, corners = cv2.findChessboardCorners(gray, size, flags=flags)
    if not ok or corners is None or len(corners) != size[0] * size[1]:
        return None
    return _refined(gray, corners.reshape(-1, 2).astype(np.float64), size)


def _refined(gray: NDArray[np.uint8], corners: Array, size: tuple[int, int]) -> Array:
    """Refine corners within a window that stays inside the four squares around each of them."""
    least = spacing(corners, Board(size[0], size[1], 1.0))
    out = corners.copy()
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-4)
    for k, corner in enumerate(corners):
        half = int(np.clip(round(0.35 * least[k]), 2, 40))
        refined = cv2.cornerSubPix(
            gray, corner.astype(np.float32).reshape(1, 1, 2), (half, half), (-1, -1), criteria
        ).reshape(2)
        if np.linalg.norm(refined - corner) < half:
            out[k] = refined
    return out


def _is_board(gray: NDArray[np.uint8], corners: Array, board: Board) -> bool:
    return _alternates(gray, corners, board) and not _continues(gray, corners, board)


def _alternates(gray: NDArray[np.uint8], corners: Array, board: Board, least_side: float = 0.3) -> bool:
    """Whether dark and bright squares meet at the corners, at least in ``least_side`` of every outer row and column.

    A detector that is asked for a larger board than there is may continue the grid over the board's margin.
    """
    grid = corners.reshape(board.rows, board.columns, 2)
    x, y = (np.asarray(np.gradient(grid, axis=axis)) for axis in (1, 0))
    around = np.stack([grid + 0.4 * (a * x + b * y) for a, b in ((1, 1), (-1, -1), (1, -1), (-1, 1))]).astype(
        np.float32
    )
    values = cv2.remap(
        cv2.GaussianBlur(gray, (3, 3), 0),
        around[..., 0].reshape(4, -1),
        around[..., 1].reshape(4, -1),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    ).reshape(4, board.rows, board.columns)
    same, other = np.sort(values[:2], axis=0), np.sort(values[2:], axis=0)
    strength = np.maximum(same[0].astype(np.float64) - other[1], other[0].astype(np.float64) - same[1])
    saddle = strength > 0.2 * max(float(np.median(strength)), 1.0)
    sides = (saddle[0], saddle[-1], saddle[:, 0], saddle[:, -1])
    return bool(saddle.mean() > 0.75 and min(side.mean() for side in sides) > least_side)


def _continues(gray: NDArray[np.uint8], corners: Array, board: Board) -> bool:
    """Whether the squares go on beyond the corners found: they are a part of a larger board."""
    grid = corners.reshape(board.rows, board.columns, 2)
    for larger, extended in (
        (Board(board.columns, board.rows + 1, board.square), np.concatenate([grid, 2 * grid[-1:] - grid[-2:-1]])),
        (Board(board.columns, board.rows + 1, board.square), np.concatenate([2 * grid[:1] - grid[1:2], grid])),
        (
            Board(board.columns + 1, board.rows, board.square),
            np.concatenate([grid, 2 * grid[:, -1:] - grid[:, -2:-1]], 1),
        ),
        (Board(board.columns + 1, board.rows, board.square), np.concatenate([2 * grid[:, :1] - grid[:, 1:2], grid], 1)),
    ):
        if _alternates(gray, extended.reshape(-1, 2), larger, 0.8):
            return True
    return False


def _any_board(gray: NDArray[np.uint8]) -> tuple[int, int] | None:
    """Return (columns, rows) of whatever chessboard of at least 3x3 inner corners is in the image, columns >= rows."""
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_NORMALIZE_IMAGE
    ok, _, meta = cv2.findChessboardCornersSBWithMeta(gray, (3, 3), flags)
    if not ok or meta is None:
        return None
    rows, columns = meta.shape[:2]
    return max(rows, columns), min(rows, columns)


def _oriented(corners: Array, board: Board) -> Array:
    grid = corners.reshape(board.rows, board.columns, 2)
    across = (grid[:, -1] - grid[:, 0]).mean(0)
    down = (grid[-1] - grid[0]).mean(0)
    if across[0] * down[1] - across[1] * down[0] < 0:
        grid = grid[::-1]
        down = -down
    if (board.columns + board.rows) % 2 == 0 and (across[0] < 0 if abs(across[0]) > abs(across[1]) else down[1] < 0):
        grid = grid[::-1, ::-1]
    return np.ascontiguousarray(grid.reshape(-1, 2))
