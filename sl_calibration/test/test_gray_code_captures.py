"""Decoding captures of Gray code: exactness, damaged captures named, corners carried over despite wrong pixels."""

import board_scenes
import numpy as np
import pytest

from pattern_gen.gray_code import Arrangement
from sl_calibration.gray_code import CaptureError, GrayMap, check_order, decode, image_count, make_capture
from sl_calibration.projector_corners import projector_corners
from sl_common import transforms

SIZE = (board_scenes.PROJECTOR.width, board_scenes.PROJECTOR.height)
POSE = board_scenes.poses(1, seed=5)[0]
IMAGES = board_scenes.gray_capture(POSE)
NAMES = [f"graycode_{k:02d}.png" for k in range(len(IMAGES))]
CORNERS = board_scenes.CAMERA.project(transforms.apply(POSE, board_scenes.BOARD.points))
EXPECTED = board_scenes.PROJECTOR.project(
    transforms.apply(board_scenes.PROJECTOR_FROM_CAMERA @ POSE, board_scenes.BOARD.points)
)


def capture(images, **options):
    return make_capture(list(images), NAMES[: len(images)], SIZE, **options)


@pytest.mark.parametrize("white", [True, False])
def test_decoded_corners_are_where_they_should_be(white):
    own = capture(IMAGES if white else IMAGES[:-2])
    check_order(own, CORNERS)
    found = projector_corners(CORNERS, decode(own), board_scenes.BOARD)
    error = np.linalg.norm(found - EXPECTED, axis=-1)
    assert np.sqrt((error**2).mean()) < 0.08
    assert error.max() < 0.25


def test_the_other_arrangement_of_code_words():
    images = board_scenes.gray_capture(POSE, arrangement=Arrangement.MAX_DISTANCE, noise=0.5)
    own = capture(images, arrangement=Arrangement.MAX_DISTANCE)
    found = projector_corners(CORNERS, decode(own), board_scenes.BOARD)
    assert np.sqrt(np.nanmean(((found - EXPECTED) ** 2).sum(-1))) < 0.3


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_wrongly_decoded_pixels_are_rejected(share):
    clean = decode(capture(IMAGES))
    rng = np.random.default_rng(0)
    wrong = rng.random(clean.column.shape) < share
    column = np.where(wrong, rng.integers(0, SIZE[0], wrong.shape), clean.column)
    row = np.where(wrong, rng.integers(0, SIZE[1], wrong.shape), clean.row)
    found = projector_corners(CORNERS, GrayMap(column, row, clean.contrast), board_scenes.BOARD)
    assert np.sqrt(((found - EXPECTED) ** 2).sum(-1).mean()) < 0.12


def test_corners_without_decoded_pixels_are_nan():
    clean = decode(capture(IMAGES))
    hole = np.zeros(clean.column.shape, dtype=bool)
    x, y = np.round(CORNERS[0]).astype(int)
    hole[y - 60 : y + 60, x - 60 : x + 60] = True
    found = projector_corners(
        CORNERS, GrayMap(np.where(hole, -1, clean.column), clean.row, clean.contrast), board_scenes.BOARD
    )
    assert np.isnan(found[0]).all()
    assert np.isfinite(found[-1]).all()


def exchanged(first, second):
    images = list(IMAGES)
    images[first], images[second] = images[second], images[first]
    return images


def test_white_and_black_exchanged():
    with pytest.raises(CaptureError, match=r"graycode_38\.png should be all white and graycode_39\.png all black"):
        capture(exchanged(38, 39))


@pytest.mark.parametrize("pair", [2, 9, 12, 15])
def test_a_bit_exchanged_with_its_inverse_is_named(pair):
    images = exchanged(2 * pair, 2 * pair + 1)
    message = rf"^graycode_{2 * pair:02d}\.png and graycode_{2 * pair + 1:02d}\.png .*are swapped"
    with pytest.raises(CaptureError, match=message):
        check_order(capture(images), CORNERS)


def test_the_first_bit_exchanged_gives_a_mirrored_map():
    with pytest.raises(
        CaptureError, match=r"mirrored: graycode_00\.png and graycode_01\.png|graycode_00\.png and graycode_01"
    ):
        check_order(capture(exchanged(0, 1)), CORNERS)


@pytest.mark.parametrize(("first", "second"), [(4, 8), (21, 30)])
def test_images_of_different_bits_exchanged_are_named(first, second):
    with pytest.raises(CaptureError, match=f"graycode_{first & ~1:02d}|graycode_{first:02d}"):
        check_order(capture(exchanged(first, second)), CORNERS)


def test_an_image_of_another_capture_is_named():
    images = list(IMAGES)
    images[7] = board_scenes.gray_capture(board_scenes.poses(1, seed=11)[0])[7]
    with pytest.raises(CaptureError, match=r"graycode_06\.png and graycode_07\.png are not a pattern and its inverse"):
        capture(images)


def test_wrong_numbers_and_sizes():
    assert image_count(SIZE) == 38
    with pytest.raises(CaptureError, match="30 images for a 640x480 projector, expected 40"):
        capture(IMAGES[:30])
    images = list(IMAGES)
    images[3] = images[3][:-10]
    with pytest.raises(CaptureError, match=r"graycode_03\.png is 800x590"):
        capture(images)
    with pytest.raises(CaptureError, match="is the projector's light in the image"):
        capture([np.full((100, 100), 30, np.uint8)] * 40)
