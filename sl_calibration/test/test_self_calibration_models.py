"""The pieces of the self-calibration: lens models, correlated errors, centroids, the factor for estimated noise."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from synthetic_views import SIZE

from sl_calibration.self_calibration import centroids, lens
from sl_calibration.self_calibration.noise_model import correlation_inflation
from sl_calibration.self_calibration.uncertainty import quantile_factor
from sl_calibration.self_calibration.views import View, flatten
from sl_common import transforms
from sl_common.cameras import CameraModel


@pytest.mark.parametrize(
    ("model", "coefficients"),
    [("none", ()), ("pers", (0.9,)), ("plumb_bob", (-0.3, 0.1, 2e-3, -1e-3, 0.02))],
)
def test_projection_agrees_with_the_camera_model_and_its_derivatives_with_differences(model, coefficients):
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.4, 0.4, (40, 2)), rng.uniform(0.8, 1.2, 40)])
    points[0, :2] = 0.0  # on the axis, where the formulas have their limits
    camera = CameraModel(640, 480, np.array([[700.0, 0, 310], [0, 720, 250], [0, 0, 1]]), model, coefficients)
    vector = lens.parameters(camera)
    pixels, by_points, by_parameters = lens.project(model, vector, points)
    np.testing.assert_allclose(pixels, camera.project(points), atol=1e-9)
    step = 1e-6
    for k in range(3):
        d = np.eye(3)[k] * step
        slope = (lens.project(model, vector, points + d)[0] - lens.project(model, vector, points - d)[0]) / (2 * step)
        np.testing.assert_allclose(by_points[:, :, k], slope, atol=2e-5, rtol=1e-6)
    for k in range(len(vector)):
        d = np.eye(len(vector))[k] * step
        slope = (lens.project(model, vector + d, points)[0] - lens.project(model, vector - d, points)[0]) / (2 * step)
        np.testing.assert_allclose(by_parameters[:, :, k], slope, atol=2e-5, rtol=1e-6)
    assert lens.with_parameters(camera, vector).coefficients == camera.coefficients


def test_correlated_errors_are_counted_as_fewer():
    rng = np.random.default_rng(0)
    grid = np.argwhere(np.ones((40, 50)))
    white = rng.normal(size=(3, 2000, 2))
    group = np.repeat(np.arange(3), 2000)
    assert correlation_inflation(np.tile(grid, (3, 1)), group, white.reshape(-1, 2)) < 1.3
    # Each value shared by blocks of 2 x 2 dots: four observations tell what one does.
    blocks = rng.normal(size=(3, 20, 25, 2)).repeat(2, axis=1).repeat(2, axis=2).reshape(-1, 2)
    assert 3.0 < correlation_inflation(np.tile(grid, (3, 1)), group, blocks) < 5.0


def test_centroid_displacement_is_that_of_a_drawn_disc():
    """Against the light-weighted centroid of a disc of the projector image on a sphere, summed point by point."""
    projector = CameraModel(*SIZE, np.array([[1900.0, 0, 512], [0, 1900, 700], [0, 0, 1]]))
    camera = CameraModel(640, 480, np.array([[800.0, 0, 320], [0, 800, 240], [0, 0, 1]]), "pers", (1.0,))
    centre, radius = np.array([0.0, -0.2, 1.5]), 0.25
    base_from_camera = transforms.look_at([0.5, 0.1, 0.7], centre - [0, 0, radius], [0.1, 1, 0])

    def hit(pixels):
        rays = projector.rays(pixels)
        b, a = rays @ centre, (rays**2).sum(-1)
        t = (b - np.sqrt(b**2 - a * (centre @ centre - radius**2))) / a
        return rays * t[..., None]

    row, col = np.meshgrid(np.arange(12), np.arange(12), indexing="ij")
    pixels = np.stack([430 + 14.0 * col, 370 + 14.0 * row], axis=-1).reshape(-1, 2)
    points = hit(pixels)
    dots = np.stack([row, col], axis=-1).reshape(-1, 2)
    cell_views = flatten(
        [View("a", dots[:, 0], dots[:, 1], np.zeros((144, 2)), np.eye(4))],
        pixels.reshape(12, 12, 2),
    )
    found, known = centroids.displacements(cell_views, points, base_from_camera[None], np.eye(4), camera, projector)
    assert known.sum() >= 60

    r, n = 4.0, 81
    offsets = np.stack(np.meshgrid(np.linspace(-r, r, n), np.linspace(-r, r, n)), axis=-1).reshape(-1, 2)
    offsets = offsets[np.linalg.norm(offsets, axis=-1) <= r]
    camera_from_base = transforms.inverse(base_from_camera)
    step = 1e-3
    for k in np.flatnonzero(known)[::7]:
        u = pixels[k] + offsets
        p = hit(u)
        normal = (p - centre) / radius
        light = -(normal * p).sum(-1) / np.linalg.norm(p, axis=-1) ** 3
        x = camera.project(transforms.apply(camera_from_base, p))
        x_u = camera.project(transforms.apply(camera_from_base, hit(u + [step, 0]))) - x
        x_v = camera.project(transforms.apply(camera_from_base, hit(u + [0, step]))) - x
        weight = light * np.abs(x_u[:, 0] * x_v[:, 1] - x_u[:, 1] * x_v[:, 0])
        centroid = (x * weight[:, None]).sum(0) / weight.sum()
        image = camera.project(transforms.apply(camera_from_base, points[k : k + 1]))[0]
        variance = (offsets[:, 0] ** 2).mean()
        np.testing.assert_allclose(variance * found[k], centroid - image, atol=2e-3)
        assert np.linalg.norm(centroid - image) > 5e-3


def test_regions_with_an_estimated_variance_hold_95_percent():
    """Of six normal errors with a variance estimated from n others, drawn a hundred thousand times."""
    rng = np.random.default_rng(0)
    for freedom in (6, 12, 40):
        errors = (rng.normal(size=(100_000, 6)) ** 2).sum(1)
        variance = rng.chisquare(freedom, 100_000) / freedom
        inside = errors / (variance * quantile_factor(freedom)) < 12.592
        assert inside.mean() == pytest.approx(0.95, abs=0.004)
    assert quantile_factor(np.inf) == 1.0
