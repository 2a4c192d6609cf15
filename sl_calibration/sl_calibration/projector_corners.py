"""Where the projector sees a board's corners: local maps from camera to projector pixels.

Moreno and Taubin (2012) fit a homography to the decoded pixels around each corner. Here the window follows the size of
the squares as they appear, whatever the resolution, wrongly decoded pixels are rejected, and a second-order map absorbs
lens distortion and paper that is not flat.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sl_calibration.chessboard import Board, BoardNotFoundError, detect_corners
from sl_calibration.gray_code import Capture, CaptureError, GrayMap, check_order, decode

Array = NDArray[np.float64]


@dataclass(frozen=True)
class MappingOptions:
    """How corners are carried over.

    Attributes:
        reach: Half side of the window around a corner, in squares.
        min_share: Least share of a window's pixels that must be decoded and agree.
        max_pixels: Windows of more pixels are thinned out.
        min_contrast: Pixels darker than this share of the window's bright pixels are left out.
    """

    reach: float = 1.0
    min_share: float = 0.15
    max_pixels: int = 4000
    min_contrast: float = 0.3


def board_in_capture(capture: Capture, board: Board) -> tuple[Array, Array]:
    """Find a board in a capture and carry its corners over to the projector.

    Returns:
        Corners (N, 2) in the camera and (N, 2) in the projector [px], NaN where too little is decoded.

    Raises:
        BoardNotFoundError: no such board. CaptureError: images out of order, or too little of the board decoded.
    """
    try:
        corners = detect_corners(capture.mean, board)
    except BoardNotFoundError:
        top = max(float(np.percentile(capture.white, 99.5)), 1.0)
        corners = detect_corners(np.clip(capture.white * (250 / top), 0, 255).astype(np.uint8), board)
    check_order(capture, corners)
    return corners, projector_corners(corners, decode(capture), board)


def projector_corners(corners: Array, gray_map: GrayMap, board: Board, options: MappingOptions | None = None) -> Array:
    """Return the projector pixels (N, 2) of a board's corners (N, 2) in the camera; NaN where too little is decoded.

    Raises:
        CaptureError: fewer than half of the corners can be carried over.
    """
    options = options or MappingOptions()
    grid = corners.reshape(board.rows, board.columns, 2)
    along_x = np.asarray(np.gradient(grid, axis=1)).reshape(-1, 2)
    along_y = np.asarray(np.gradient(grid, axis=0)).reshape(-1, 2)
    homography, tolerance = _board_homography(corners, gray_map)
    out = np.full(corners.shape, np.nan)
    for k, corner in enumerate(corners):
        square = np.stack([along_x[k], along_y[k]], axis=-1)
        found = _local_map(corner, square, gray_map, homography, tolerance, options)
        if found is not None:
            out[k] = found
    missing = int(np.isnan(out[:, 0]).sum())
    if missing > len(corners) // 2:
        raise CaptureError(
            f"{missing} of {len(corners)} corners lack decoded pixels around them: is all of the board lit by the"
            " projector, and neither over- nor underexposed?"
        )
    return out


def _board_homography(corners: Array, gray_map: GrayMap) -> tuple[Array, float]:
    """Fit a homography from camera to projector over the board, robustly; return it and a tolerance [projector px]."""
    mask = np.zeros(gray_map.column.shape, dtype=np.uint8)
    cv2.fillConvexPoly(mask, cv2.convexHull(np.round(corners).astype(np.int32)), 1)
    y, x = np.nonzero(mask.astype(bool) & gray_map.decoded)
    if len(x) < 100:
        raise CaptureError(f"only {len(x)} pixels of the board are decoded: is it lit by the projector?")
    chosen = np.random.default_rng(0).permutation(len(x))[:5000]
    x, y = x[chosen], y[chosen]
    camera = np.stack([x, y], axis=-1).astype(np.float64)
    projector = np.stack([gray_map.column[y, x], gray_map.row[y, x]], axis=-1).astype(np.float64)
    homography, _ = cv2.findHomography(camera, projector, cv2.LMEDS)
    if homography is None:
        raise CaptureError(
            "the decoded pixels of the board are no plane: wrong order of images or wrong --projector size"
        )
    error = np.abs(_mapped(homography, camera) - projector).max(-1)
    return homography, 6 * float(np.median(error)) + 3.0


def _local_map(
    corner: Array, square: Array, gray_map: GrayMap, homography: Array, tolerance: float, options: MappingOptions
) -> Array | None:
    height, width = gray_map.column.shape
    extent = options.reach * np.abs(square).sum(axis=1)
    low = np.maximum(np.floor(corner - extent), 0).astype(int)
    high = np.minimum(np.ceil(corner + extent), (width - 1, height - 1)).astype(int)
    area = float(np.prod(np.maximum(high - low, 1)))
    stride = max(1, int(np.sqrt(area / options.max_pixels)))
    x, y = (
        axis.ravel()
        for axis in np.meshgrid(np.arange(low[0], high[0] + 1, stride), np.arange(low[1], high[1] + 1, stride))
    )
    if abs(np.linalg.det(square)) < 1e-9 or not len(x):
        return None
    place = np.linalg.solve(square, np.stack([x - corner[0], y - corner[1]]))
    inside = np.abs(place).max(axis=0) <= options.reach
    x, y, place = x[inside], y[inside], place[:, inside]
    window = max(len(x), 1)
    contrast = gray_map.contrast[y, x]
    bright = contrast > options.min_contrast * np.percentile(contrast, 90) if len(x) else contrast > 0
    usable = bright & gray_map.decoded[y, x]
    target = np.stack([gray_map.column[y, x], gray_map.row[y, x]], axis=-1).astype(np.float64)
    expected = _mapped(homography, np.stack([x, y], axis=-1).astype(np.float64))
    usable &= np.abs(target - expected).max(-1) < tolerance
    if usable.sum() < max(options.min_share * window, 30):
        return None
    u, v = place[:, usable]
    target = target[usable]
    basis = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)
    weight = np.ones(len(u))
    value = np.full(2, np.nan)
    for _ in range(6):
        weighted = basis * weight[:, None]
        coefficients = np.linalg.lstsq(weighted.T @ basis, weighted.T @ target, rcond=None)[0]
        error = np.linalg.norm(target - basis @ coefficients, axis=-1)
        scale = max(1.4826 * float(np.median(error)), 0.4)
        weight = np.maximum(1 - (error / (4 * scale)) ** 2, 0) ** 2
        if (weight > 0).sum() < max(options.min_share * window, 30):
            return None
        value = coefficients[0]
    return value


def _mapped(homography: Array, pixels: Array) -> Array:
    mapped = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=-1) @ homography.T
    return mapped[:, :2] / mapped[:, 2:]
