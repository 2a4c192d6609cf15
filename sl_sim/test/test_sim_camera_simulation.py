from dataclasses import replace

import numpy as np
import pytest

from pattern_gen import default_pattern
from sl_sim.camera_simulation import CameraSimulation
from sl_sim.cell import Cell, CellSettings
from sl_sim.effects import EFFECTS
from sl_sim.errors import CellError
from sl_sim.exposures import Exposure

SMALL = CellSettings(scene="sphere", camera_width=320, camera_height=240, focal_length=410.0)
QUICK = replace(EFFECTS["lab"], render=replace(EFFECTS["lab"].render, interreflection=False, lattice=2))
PROJECTED = np.ascontiguousarray(default_pattern().render()[..., ::-1])


def still(cell, **more):
    return Exposure(0, np.tile(cell.start_positions, (7, 1)), cell.base_from_object, **more)


def test_dark_until_the_projector_shows_something_and_exposure_adapts():
    cell = Cell(SMALL)
    camera = CameraSimulation(cell, QUICK)
    dark = camera.take(still(cell))
    lit = [camera.take(still(cell, projector_bgr=PROJECTED if k == 0 else None)) for k in range(4)]
    assert lit[-1].exposure < dark.exposure
    saturated = (lit[-1].image == 255).any(-1).mean()
    assert saturated < 0.01
    assert lit[-1].image.max() > 200
    np.testing.assert_allclose(lit[0].base_from_camera, cell.base_from_camera(cell.start_positions))


def test_the_image_is_that_of_the_seed():
    images = []
    for seed in (0, 0, 1):
        cell = Cell(replace(SMALL, seed=seed))
        images.append(CameraSimulation(cell, QUICK).take(still(cell, projector_bgr=PROJECTED)).image)
    np.testing.assert_array_equal(images[0], images[1])
    assert (images[0] != images[2]).mean() > 0.1


def test_motion_during_the_exposure_blurs_and_the_pose_is_that_of_its_middle():
    cell = Cell(SMALL)
    noiseless = replace(QUICK, sensor=replace(QUICK.sensor, noise=False))
    camera = CameraSimulation(cell, noiseless)
    sharp = camera.take(still(cell, projector_bgr=PROJECTED)).image.astype(float)
    sweep = cell.start_positions + np.linspace(-1, 1, 7)[:, None] * np.array([0.004, 0, 0, 0, 0, 0])
    taken = camera.take(Exposure(0, sweep, cell.base_from_object))
    np.testing.assert_allclose(taken.base_from_camera, cell.base_from_camera(cell.start_positions))
    assert np.abs(np.diff(taken.image.astype(float), axis=1)).mean() < 0.85 * np.abs(np.diff(sharp, axis=1)).mean()


def test_a_projector_image_of_another_size_is_refused():
    with pytest.raises(CellError, match="expected"):
        CameraSimulation(Cell(SMALL), QUICK).show(np.zeros((100, 100, 3), np.uint8))
