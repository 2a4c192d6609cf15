"""Known truth for the grid calibrations: views of a board, corners in camera and projector, photographs of Gray
code."""

from dataclasses import dataclass, replace
from functools import cache

import cv2
import numpy as np

from pattern_gen import Pattern, default_pattern
from pattern_gen.gray_code import Arrangement, Axis, bit_count, code_frame
from sl_calibration.chessboard import Board
from sl_common import transforms
from sl_common.cameras import CameraModel

BOARD = Board(9, 7, 0.04)
CAMERA = CameraModel(
    800, 600, np.array([[900.0, 0, 410], [0, 900.0, 290], [0, 0, 1]]), "plumb_bob", (-0.18, 0.05, 0.0005, -0.0003, 0.0)
)
PROJECTOR = CameraModel(640, 480, np.array([[800.0, 0, 330], [0, 800.0, 540], [0, 0, 1]]))  # lens shift: cy below
PROJECTOR_FROM_CAMERA = transforms.inverse(
    transforms.make(transforms.rotation_exp([0.03, 0.31, 0.02]), [-0.25, 0.30, 0.02])
)


def poses(number: int, *, distance: float = 0.75, tilt: float = 0.5, seed: int = 0, board: Board = BOARD) -> np.ndarray:
    """camera_from_board (number, 4, 4): the board in the middle of the view, tilted and turned at random."""
    rng = np.random.default_rng(seed)
    centre = board.points.mean(0)
    out = []
    for _ in range(number):
        turn = transforms.rotation_exp(
            np.array([rng.uniform(-tilt, tilt), rng.uniform(-tilt, tilt), rng.uniform(-0.2, 0.2)])
        )
        middle = np.array([rng.uniform(-0.1, 0.1), rng.uniform(-0.06, 0.06), 1.0]) * distance * rng.uniform(0.9, 1.3)
        out.append(transforms.make(turn, middle - turn @ centre))
    return np.array(out)


def corners_of(
    camera: CameraModel, camera_from_board: np.ndarray, *, noise: float, seed: int = 1, board: Board = BOARD
):
    """(V, N, 2) noisy corners."""
    rng = np.random.default_rng(seed)
    exact = np.stack([camera.project(transforms.apply(pose, board.points)) for pose in camera_from_board])
    return exact + rng.normal(0, noise, exact.shape)


@dataclass(frozen=True)
class PairScene:
    """Corners (V, N, 2) of a board in camera and projector, and the true poses of the board."""

    camera_corners: np.ndarray
    projector_corners: np.ndarray
    camera_from_board: np.ndarray


def pair_scene(number: int, *, noise: float = 0.1, seed: int = 0) -> PairScene:
    """Views of the board by CAMERA and PROJECTOR."""
    truth = poses(number, seed=seed)
    in_camera = corners_of(CAMERA, truth, noise=noise, seed=seed + 1)
    in_projector = corners_of(PROJECTOR, PROJECTOR_FROM_CAMERA @ truth, noise=noise, seed=seed + 2)
    return PairScene(in_camera, in_projector, truth)


def board_albedo(camera: CameraModel, camera_from_board: np.ndarray, board: Board) -> np.ndarray:
    """(H, W) albedo of a board before a grey wall, edges antialiased; the board has one square more each way."""
    oversampling = 2
    ideal = plane_coordinates(camera, camera_from_board, oversampling) / board.square
    x, y = ideal[..., 0] + 1, ideal[..., 1] + 1
    inside = (x > 0) & (y > 0) & (x < board.columns + 1) & (y < board.rows + 1)
    margin = (x > -0.6) & (y > -0.6) & (x < board.columns + 1.6) & (y < board.rows + 1.6)
    dark = (np.floor(x) + np.floor(y)) % 2 == 0
    albedo = np.where(inside & dark, 0.08, np.where(margin, 0.85, 0.45))
    return cv2.resize(albedo, (camera.width, camera.height), interpolation=cv2.INTER_AREA)


def plane_coordinates(camera: CameraModel, camera_from_board: np.ndarray, oversampling: int = 1) -> np.ndarray:
    """(H, W, 2) coordinates [m] on the board's plane of each pixel's ray."""
    rays = _rays(camera, oversampling)
    normal, origin = camera_from_board[:3, 2], camera_from_board[:3, 3]
    points = rays * ((origin @ normal) / (rays @ normal))[:, None]
    local = transforms.apply(transforms.inverse(camera_from_board), points)
    return local[:, :2].reshape(camera.height * oversampling, camera.width * oversampling, 2)


@cache
def _rays(camera: CameraModel, oversampling: int) -> np.ndarray:
    v, u = np.mgrid[: camera.height * oversampling, : camera.width * oversampling]
    return camera.rays((np.stack([u, v], axis=-1).reshape(-1, 2) + 0.5) / oversampling - 0.5)


def gray_capture(
    camera_from_board: np.ndarray,
    *,
    board: Board = BOARD,
    camera: CameraModel = CAMERA,
    projector: CameraModel = PROJECTOR,
    projector_from_camera: np.ndarray = PROJECTOR_FROM_CAMERA,
    noise: float = 1.0,
    arrangement: Arrangement = Arrangement.REFLECTED,
    seed: int = 0,
) -> list[np.ndarray]:
    """Photographs (uint8) of the whole sequence on the board: bits and inverses, columns then rows, white, black."""
    rng = np.random.default_rng(seed)
    albedo, place = lit_board(
        camera_from_board, board=board, camera=camera, projector=projector, projector_from_camera=projector_from_camera
    )
    size = (projector.width, projector.height)
    frames = [
        code_frame(*size, axis, bit, inverse=inverse, arrangement=arrangement)[..., 0]
        for axis, length in ((Axis.COLUMNS, size[0]), (Axis.ROWS, size[1]))
        for bit in range(bit_count(length))
        for inverse in (False, True)
    ]
    frames += [np.full(size[::-1], 255, np.uint8), np.zeros(size[::-1], np.uint8)]
    return [photograph(frame, albedo, place, noise, rng) for frame in frames]


def lit_board(
    camera_from_board: np.ndarray,
    *,
    board: Board = BOARD,
    camera: CameraModel = CAMERA,
    projector: CameraModel = PROJECTOR,
    projector_from_camera: np.ndarray = PROJECTOR_FROM_CAMERA,
) -> tuple[np.ndarray, np.ndarray]:
    """Albedo (H, W) of a board as the camera sees it, and which projector pixel (H, W, 2) lights each pixel."""
    plane = plane_coordinates(camera, camera_from_board)
    points = np.concatenate([plane, np.zeros((*plane.shape[:2], 1))], axis=-1).reshape(-1, 3)
    seen = projector.project(transforms.apply(projector_from_camera @ camera_from_board, points))
    place = seen.reshape(*plane.shape).astype(np.float32)
    place = np.where(np.isfinite(place), place, -10).astype(np.float32)
    return board_albedo(camera, camera_from_board, board), place


def photograph(
    frame: np.ndarray, albedo: np.ndarray, place: np.ndarray, noise: float, rng: np.random.Generator
) -> np.ndarray:
    """Photograph (H, W) uint8 of a projected frame (h, w) uint8, with noise [grey levels]."""
    light = cv2.remap(frame, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderValue=0)
    image = 12 * albedo + 0.75 * albedo * light + rng.normal(0, noise, albedo.shape)
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def small_pattern() -> Pattern:
    """A pattern for PROJECTOR."""
    shipped = default_pattern()
    return replace(
        shipped,
        symbols=shipped.symbols[:24, :34],
        projector_width=PROJECTOR.width,
        projector_height=PROJECTOR.height,
        pitch=18.0,
        origin=(20.0, 20.0),
    )
