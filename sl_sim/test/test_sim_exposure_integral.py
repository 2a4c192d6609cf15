from dataclasses import replace

import numpy as np
import pytest

from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_sim import meshes
from sl_sim.effects import EFFECTS
from sl_sim.exposure_integral import exposed_radiance, lens_points
from sl_sim.light import LightSource, aimed_projector
from sl_sim.projector import light_image
from sl_sim.raycast import Body, RayCaster
from sl_sim.render_options import RenderOptions
from sl_sim.renderer import Renderer

CAMERA = CameraModel(160, 120, np.array([[410.0, 0, 81.0], [0, 410.0, 59.0], [0, 0, 1.0]]))
PROJECTOR = CameraModel(256, 192, np.array([[470.0, 0, 127.5], [0, 470.0, 190.0], [0, 0, 1.0]]))
UP = np.array([0.0, 1.0, 0.0])
VIEW = transforms.look_at(np.array([0.05, -0.02, 0.8]), np.zeros(3), UP)


def render(effects):
    image = np.zeros((192, 256, 3), np.uint8)
    image[92:100, 124:132] = 255  # one square of light near the middle
    pose = aimed_projector(PROJECTOR, np.array([-0.1, 0.1, 0.95]), np.zeros(3), up=UP)
    caster = RayCaster([Body(meshes.rectangle(3, 3), np.eye(4))])
    renderer = Renderer(caster, CAMERA, LightSource(PROJECTOR, pose), RenderOptions(ambient=0.0))
    return exposed_radiance(renderer, light_image(image, effects.projector), VIEW, effects, 0.8)


def moments(image):
    weight = np.maximum(image.sum(-1) - np.median(image.sum(-1)), 0)
    rows, cols = np.mgrid[: image.shape[0], : image.shape[1]]
    total = weight.sum()
    mean = np.array([(weight * cols).sum(), (weight * rows).sum()]) / total
    spread = np.array([(weight * (cols - mean[0]) ** 2).sum(), (weight * (rows - mean[1]) ** 2).sum()]) / total
    return total, mean, spread


def test_motion_smears_the_light_along_its_way_and_leaves_its_middle():
    still = moments(render(EFFECTS["clean"]))
    swept = moments(render(replace(EFFECTS["clean"], twist=(0.004, 0, 0, 0, 0, 0))))
    assert swept[0] == pytest.approx(still[0], rel=0.01)
    np.testing.assert_allclose(swept[1], still[1], atol=0.03)
    length = 0.004 * 410 / np.linalg.norm(VIEW[:3, 3])  # px; seven instants spread evenly
    assert swept[2][0] - still[2][0] == pytest.approx(length**2 / 12, rel=0.08)
    assert swept[2][1] == pytest.approx(still[2][1], rel=0.02)


def test_defocus_spreads_the_light_by_the_circle_of_confusion_and_leaves_its_middle():
    still = moments(render(EFFECTS["clean"]))
    sharp = moments(render(replace(EFFECTS["clean"], aperture=0.01, focus=1.0)))
    soft = moments(render(replace(EFFECTS["clean"], aperture=0.01, focus=1.5)))
    np.testing.assert_allclose(soft[1], still[1], atol=0.1)
    assert soft[0] == pytest.approx(still[0], rel=0.02)
    np.testing.assert_allclose(sharp[2], still[2], rtol=0.02)
    diameter = 0.01 * 410 * (1 / 0.8 - 1 / (1.5 * 0.8))
    np.testing.assert_allclose(soft[2] - still[2], diameter**2 / 16, rtol=0.25)


def test_a_pupil_is_filled_evenly():
    points = np.array(lens_points(0.004, 200))
    assert np.linalg.norm(points, axis=1).max() <= 0.002
    assert np.abs(points.mean(0)).max() < 1e-5 * 5
    assert (points**2).sum(1).mean() == pytest.approx(0.5 * 0.002**2, rel=0.02)
    assert lens_points(0.0, 12) == [(0.0, 0.0)]
