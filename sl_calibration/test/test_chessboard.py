"""Detection of chessboards: accuracy, order of the corners, and what is said of a wrong size."""

import board_scenes
import cv2
import numpy as np
import pytest

from sl_calibration.chessboard import Board, BoardNotFoundError, detect_corners, parse_size, spacing
from sl_common import transforms
from sl_common.errors import InvalidInputError


def photograph(pose, board=board_scenes.BOARD, camera=board_scenes.CAMERA):
    rng = np.random.default_rng(3)
    image = 230 * board_scenes.board_albedo(camera, pose, board) + rng.normal(0, 1.5, (camera.height, camera.width))
    return np.clip(image, 0, 255).astype(np.uint8)


def truth(pose, board=board_scenes.BOARD, camera=board_scenes.CAMERA):
    return camera.project(transforms.apply(pose, board.points))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_corners_are_accurate_and_in_order(seed):
    pose = board_scenes.poses(1, seed=seed)[0]
    found = detect_corners(photograph(pose), board_scenes.BOARD)
    assert np.sqrt(((found - truth(pose)) ** 2).sum(-1).mean()) < 0.1


def test_a_board_given_transposed_is_found_in_the_order_asked_for():
    pose = board_scenes.poses(1, seed=1)[0]
    found = detect_corners(photograph(pose), Board(7, 9, 0.04)).reshape(9, 7, 2)
    across, down = found[:, -1] - found[:, 0], found[-1] - found[0]
    assert (across[:7, 0] * down[:, 1] - across[:7, 1] * down[:, 0] > 0).all()
    assert np.linalg.norm(down.mean(0)) > np.linalg.norm(across.mean(0))


def test_colour_images_and_other_resolutions():
    pose = board_scenes.poses(1, seed=2)[0]
    image = cv2.resize(photograph(pose), None, fx=2.5, fy=2.5, interpolation=cv2.INTER_CUBIC)
    found = detect_corners(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), board_scenes.BOARD)
    expected = (truth(pose) + 0.5) * 2.5 - 0.5
    assert np.sqrt(((found - expected) ** 2).sum(-1).mean()) < 0.3


@pytest.mark.parametrize("size", [(8, 6), (10, 7), (9, 6)])
def test_a_wrong_size_is_told_by_what_is_there(size):
    with pytest.raises(BoardNotFoundError, match="but one of 9x7") as caught:
        detect_corners(photograph(board_scenes.poses(1)[0]), Board(*size, 0.04))
    assert caught.value.found == (9, 7)


def test_no_board_at_all():
    noise = np.random.default_rng(0).integers(0, 255, (300, 400), dtype=np.uint8)
    with pytest.raises(BoardNotFoundError, match="no chessboard of 9x7"):
        detect_corners(noise, board_scenes.BOARD)


def test_boards_that_cannot_be():
    with pytest.raises(InvalidInputError, match=r"mixed units\? Give it in metres, 0\.03"):
        Board(8, 6, 30.0)
    with pytest.raises(InvalidInputError, match="at least 3x3"):
        Board(2, 6, 0.03)
    with pytest.raises(InvalidInputError, match="positive"):
        Board(8, 6, -0.03)
    with pytest.raises(InvalidInputError, match="expected two whole numbers"):
        parse_size("8by6")
    assert parse_size("8x6") == (8, 6)


def test_spacing_is_the_least_distance_to_a_neighbour():
    grid = Board(4, 3, 1.0).points[:, :2] * (3, 2)
    assert np.allclose(spacing(grid, Board(4, 3, 1.0)), 2.0)
