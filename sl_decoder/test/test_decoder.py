"""The decoder from outside: views, letters, grids, mirrors, foreign patterns, wrong letters, bad input."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from decoder_helpers import camera_image, default_pattern, hexagonal_pattern, monochrome_pattern, project

from sl_common.errors import StructuredLightError
from sl_decoder import Decoder, DecoderOptions, Reason
from sl_decoder.colours import Colours
from sl_decoder.reliability import robustness
from sl_decoder.synthetic import view

PATTERN = default_pattern()
DECODER = Decoder(PATTERN)


def errors(decoded, affine: np.ndarray) -> np.ndarray:
    want = decoded.projector @ affine[:, :2].T + affine[:, 2]
    return np.linalg.norm(decoded.camera - want, axis=1)


@pytest.mark.parametrize("angle", [0.0, 0.4, 0.8, 1.6, 2.5, 3.6, 5.0])
def test_any_roll(angle: float) -> None:
    affine = view(PATTERN, angle=angle, scale=0.5, seed=2)
    decoded = DECODER.decode(project(PATTERN, affine))
    at = PATTERN.centers @ affine[:, :2].T + affine[:, 2]
    seen = ((at > 8) & (at < np.array([631, 471]))).all(-1)
    assert len(decoded) >= 0.99 * seen.sum()
    assert errors(decoded, affine).max() < 0.5
    assert (decoded.confidence > 0.85).all()
    assert (np.diff(decoded.row * PATTERN.cols + decoded.col) > 0).all()


@pytest.mark.parametrize("pattern", [hexagonal_pattern(), monochrome_pattern()], ids=["hexagonal", "monochrome shapes"])
def test_other_grids_and_letters(pattern) -> None:
    affine = view(pattern, angle=0.7, scale=0.75, seed=1)
    decoded = Decoder(pattern).decode(project(pattern, affine, (800, 700)))
    at = pattern.centers @ affine[:, :2].T + affine[:, 2]
    assert len(decoded) >= 0.99 * ((at > 8) & (at < np.array([791, 691]))).all(-1).sum()
    assert errors(decoded, affine).max() < 0.7


def test_a_pattern_seen_in_a_mirror_is_refused_and_named() -> None:
    image = camera_image(PATTERN, 640, 480)
    decoded = DECODER.decode(np.ascontiguousarray(image[:, ::-1]))
    assert len(decoded) == 0
    assert decoded.mirrored
    assert (decoded.inspection.reason == Reason.MIRRORED).sum() > 2000
    assert not DECODER.decode(image).mirrored


def test_another_pattern_of_the_same_letters_gives_nothing() -> None:
    rng = np.random.default_rng(5)
    for seed in range(5):
        other = replace(PATTERN, symbols=rng.integers(0, 6, PATTERN.symbols.shape).astype(np.uint8))
        assert len(DECODER.decode(camera_image(other, 640, 480, seed=seed))) == 0


@pytest.mark.parametrize("blur", [0.6, 1.0, 1.5])
@pytest.mark.parametrize("scale", [0.28, 0.4, 0.5])
def test_shapes_and_intensities_that_blur_alike_are_told_apart(scale: float, blur: float) -> None:
    pattern = monochrome_pattern()
    affine = view(pattern, angle=0.7, scale=scale, seed=1)
    decoded = Decoder(pattern).decode(project(pattern, affine, blur=blur))
    at = pattern.centers @ affine[:, :2].T + affine[:, 2]
    assert len(decoded) >= 0.97 * ((at > 8) & (at < np.array([631, 471]))).all(-1).sum()
    assert (errors(decoded, affine) < 2.0).all()


@pytest.mark.parametrize("seed", range(3))
def test_noisy_dots_seen_from_near_are_read(seed: int) -> None:
    affine = view(PATTERN, angle=0.7 + seed, scale=6.0, seed=seed)
    decoded = DECODER.decode(project(PATTERN, affine, blur=3.6, light=0.25, noise=4.0, seed=seed))
    at = PATTERN.centers @ affine[:, :2].T + affine[:, 2]
    assert len(decoded) >= ((at > 48) & (at < np.array([592, 432]))).all(-1).sum() >= 20
    assert errors(decoded, affine).max() < 0.5


def test_disjoint_patches_are_all_decoded() -> None:
    image = camera_image(PATTERN, 640, 480)
    whole = DECODER.decode(image)
    image[:, 200:230] = 20
    image[220:260] = 20
    cut = DECODER.decode(image)
    x, y = whole.camera.T
    clear = ((x < 185) | (x > 245)) & ((y < 205) | (y > 275))
    assert len(cut) >= 0.99 * clear.sum()
    same = np.intersect1d(whole.row * 100 + whole.col, cut.row * 100 + cut.col)
    assert len(same) == len(cut)


def test_a_shifted_part_is_cut_off_the_rest_or_placed_right() -> None:
    affine = view(PATTERN, angle=0.0, scale=0.55, seed=2)
    image = project(PATTERN, affine, noise=1.0)
    pitch = PATTERN.pitch * affine[1, 1]
    step = round(2 * pitch)  # the right part of a depth edge moved by about two dots: the lattice seems to go on
    image[:-step, 330:] = image[step:, 330:].copy()
    decoded = DECODER.decode(image)
    moved = affine.copy()
    moved[1, 2] -= step
    right = decoded.camera[:, 0] > 330
    assert errors(decoded, affine)[~right & (decoded.camera[:, 0] < 322)].max() < 0.7
    assert errors(decoded, moved)[right & (decoded.camera[:, 0] > 338)].max() < 0.7
    assert len(decoded) > 1800


@pytest.mark.parametrize("scale", [255 / 900, 1.0, 6.0])
def test_exposure(scale: float) -> None:
    affine = view(PATTERN, angle=0.3, scale=0.5, seed=1)
    image = cv2.warpAffine(PATTERN.render()[:, :, ::-1], affine, (640, 480), flags=cv2.INTER_AREA).astype(np.float32)
    exposed = np.clip(
        cv2.GaussianBlur(image, (0, 0), 0.7) * scale + np.random.default_rng(0).normal(2, 1, image.shape), 0, 255
    )
    decoded = DECODER.decode(exposed.astype(np.uint8))
    assert len(decoded) > 2300
    assert errors(decoded, affine).max() < 0.8


def test_unequal_channels_and_crosstalk() -> None:
    mixing = np.array([[0.7, 0.25, 0.1], [0.2, 0.6, 0.25], [0.05, 0.15, 0.35]])
    affine = view(PATTERN, angle=2.0, scale=0.5, seed=1)
    image = project(PATTERN, affine, noise=0.0).astype(np.float32) @ mixing.T
    image = np.clip(image + np.random.default_rng(1).normal(0, 2, image.shape), 0, 255).astype(np.uint8)
    decoded = DECODER.decode(image)
    assert len(decoded) > 2300
    assert errors(decoded, affine).max() < 0.6


def test_wrong_letters_make_gaps_not_errors() -> None:
    right, wrong, _ = robustness(PATTERN, flipped=0.05, runs=5)
    assert right > 0.9
    assert wrong <= 0.001
    right, wrong, _ = robustness(PATTERN, missing=0.05, runs=5)
    assert right > 0.95
    assert wrong <= 0.001


def test_confidence_threshold_and_calibrated_colours() -> None:
    image = camera_image(PATTERN, 640, 480)
    strict = Decoder(PATTERN, options=DecoderOptions(min_confidence=0.9999)).decode(image)
    assert (strict.confidence >= 0.9999).all()
    assert len(strict) <= len(DECODER.decode(image))
    colours = Colours(np.array([letter.rgb for letter in PATTERN.letters], float))
    assert len(Decoder(PATTERN, colours=colours).decode(image)) > 2450
    with pytest.raises(StructuredLightError, match="4 letters, the pattern 6"):
        Decoder(PATTERN, colours=Colours(np.ones((4, 3))))


@pytest.mark.parametrize(
    "image",
    [np.zeros((10, 10, 3), np.uint8), np.zeros((100, 100), np.uint8), np.zeros((100, 100, 3), np.float32), None],
)
def test_bad_input_is_refused(image) -> None:
    with pytest.raises(StructuredLightError):
        DECODER.decode(image)


def test_empty_and_uniform_images_give_nothing() -> None:
    for value in (0, 128, 255):
        decoded = DECODER.decode(np.full((480, 640, 3), value, np.uint8))
        assert len(decoded) == 0
        assert decoded.camera.shape == (0, 2)


@pytest.mark.parametrize(
    "pattern", [PATTERN, hexagonal_pattern(), monochrome_pattern()], ids=["square", "hexagonal", "monochrome shapes"]
)
def test_images_of_other_things_give_nothing(pattern) -> None:
    decoder = Decoder(pattern)
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:480, :640]
    images = [rng.integers(0, 256, (480, 640, 3)), rng.normal(90, 8, (480, 640, 3)), np.zeros((480, 640, 3))]
    for k in range(10):  # dots, but no lattice
        cv2.circle(images[2], (30 + 3 * k * k, 30 + 42 * k), 3, (200, 200, 200), -1)
    images += [np.repeat((x // side + y // side) % 2 * 200.0 + 20, 3).reshape(480, 640, 3) for side in (4, 8, 20)]
    images += [camera_image(other, 640, 480) for other in (PATTERN, monochrome_pattern(seed=1)) if other != pattern]
    for image in images:
        assert len(decoder.decode(image.astype(np.uint8))) == 0


def test_the_same_image_gives_the_same_result() -> None:
    image = camera_image(PATTERN, 640, 480, seed=4)
    one, two = DECODER.decode(image), DECODER.decode(image)
    assert (one.camera == two.camera).all()
    assert (one.confidence == two.confidence).all()


@pytest.mark.parametrize(("scale", "blur"), [(0.33, 0.9), (0.36, 1.0), (0.4, 1.2)])
def test_small_dots_that_blur_into_each_other_are_read(scale: float, blur: float) -> None:
    affine = view(PATTERN, angle=0.5, scale=scale, seed=2)
    decoded = DECODER.decode(cv2.GaussianBlur(project(PATTERN, affine), (0, 0), blur))
    assert len(decoded) >= 0.99 * PATTERN.symbols.size
    assert np.median(errors(decoded, affine)) < 0.15
    assert errors(decoded, affine).max() < 0.7
