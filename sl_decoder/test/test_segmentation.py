"""Segmentation and centres on images of known dots."""

import cv2
import numpy as np
import pytest

from sl_decoder.centres import measure
from sl_decoder.segmentation import segment


def draw(centres: np.ndarray, *, sigma: float, level: float = 200.0, size: tuple[int, int] = (240, 320)) -> np.ndarray:
    """Gaussian dots (H, W) float."""
    y, x = np.mgrid[: size[0], : size[1]].astype(np.float64)
    image = np.zeros(size)
    for cx, cy in centres:
        image += level * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * sigma**2))
    return image


def lattice(pitch: float, rng: np.random.Generator) -> np.ndarray:
    v, u = np.mgrid[20:220:pitch, 20:300:pitch]
    return np.stack([u.ravel(), v.ravel()], 1) + rng.uniform(-0.5, 0.5, (u.size, 2))


def colour(image: np.ndarray) -> np.ndarray:
    return np.clip(np.repeat(image[..., None], 3, axis=2), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("pitch", "sigma"), [(6.0, 1.1), (9.0, 1.5), (16.0, 3.0), (30.0, 5.0)])
def test_every_dot_once_at_its_sub_pixel_centre(pitch: float, sigma: float) -> None:
    rng = np.random.default_rng(1)
    centres = lattice(pitch, rng)
    image = draw(centres, sigma=sigma) + rng.normal(20, 2, (240, 320))
    dots = measure(segment(colour(image), round(1.6 * pitch)))
    distance = np.linalg.norm(dots.centre[:, None] - centres[None], axis=2)
    assert (distance.min(0) < 0.5).all()
    found = distance.min(0)
    assert np.median(found) < 0.05
    assert (np.bincount(distance.argmin(0), minlength=len(dots)) <= 1).all()


def test_ambient_gradient_and_its_colour_drop_out() -> None:
    rng = np.random.default_rng(2)
    centres = lattice(12.0, rng)
    dots = draw(centres, sigma=1.8, level=60.0)
    ambient = np.linspace(10, 150, 320)[None, :, None] * np.array([0.6, 0.8, 1.0])
    image = np.clip(dots[..., None] * np.array([1.0, 0.1, 0.05]) + ambient + rng.normal(0, 1, (240, 320, 3)), 0, 255)
    found = measure(segment(image.astype(np.uint8), 18))
    distance = np.linalg.norm(found.centre[:, None] - centres[None], axis=2)
    assert (distance.min(0) < 0.7).mean() > 0.99
    near = distance.argmin(0)
    assert (found.colour[near].argmax(1) == 0).all()  # blue, whatever the lamp's colour


def test_close_dots_stay_apart_and_a_bright_neighbour_hides_none() -> None:
    centres = np.array([[50.0, 60.0], [54.5, 60.0], [100.0, 60.0], [105.0, 60.0]])
    image = draw(centres[[0, 1, 2]], sigma=1.2) + draw(centres[[3]], sigma=1.2, level=60.0)
    dots = measure(segment(colour(image), 15))
    distance = np.linalg.norm(dots.centre[:, None] - centres[None], axis=2)
    assert (distance.min(0) < 0.6).all()


def test_a_black_image_and_pure_noise_have_no_large_blobs() -> None:
    assert len(segment(np.zeros((240, 320, 3), np.uint8), 15)) == 0
    noise = np.random.default_rng(0).normal(60, 5, (240, 320, 3)).clip(0, 255).astype(np.uint8)
    assert len(segment(noise, 15)) < 300


def test_saturated_and_cut_dots_are_marked() -> None:
    image = draw(np.array([[100.0, 100.0]]), sigma=3.0, level=3000.0) + draw(np.array([[2.5, 50.0]]), sigma=3.0)
    dots = measure(segment(colour(cv2.min(image, 255.0)), 40))
    order = np.argsort(dots.centre[:, 0])
    assert dots.cut[order[0]]
    assert dots.saturated[order[-1]] > 0.5


def test_a_dot_that_light_leaves_on_one_side_is_marked() -> None:
    y, x = np.mgrid[:60, :120].astype(np.float64)
    discs = [((x - cx) ** 2 / 49 + (y - 30) ** 2 / 324 <= 1) for cx in (30, 90)]
    fading = np.clip((y - 12) / 36, 0, 1)  # as at a limb that the light grazes
    light = 180.0 * (discs[0] + discs[1] * fading)
    image = cv2.GaussianBlur(light, (0, 0), 0.8) + np.random.default_rng(3).normal(20, 2, light.shape)
    dots = measure(segment(colour(image), 51))
    whole, half_lit = (np.flatnonzero(abs(dots.centre[:, 0] - cx) < 7) for cx in (30, 90))
    assert not dots.cut[whole].any()
    assert dots.cut[half_lit].all()
    assert len(whole) == len(half_lit) == 1
