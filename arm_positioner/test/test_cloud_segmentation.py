import numpy as np
import pytest
from positioner_scenes import box, cast, nearest, plane, sphere

from arm_positioner.segmentation import components, nearest_component, spacing

WALL = plane((0, 0, 1.2), (0, 0, -1.0))


def test_a_tilted_plane_is_one_patch_with_and_without_the_map():
    for tilt in (0.0, 0.5, 1.0):
        points, row, col = cast(plane((0, 0, 1.0), (np.sin(tilt), 0, -np.cos(tilt))), noise=3e-4)
        assert (components(points, row, col) == 0).mean() > 0.99
        assert (components(points) == 0).mean() > 0.99


def test_a_sphere_is_separated_from_the_wall():
    ball = sphere((0.02, 0.01, 1.0), 0.09)
    points, row, col = cast(nearest(ball, WALL), noise=3e-4)
    on_ball = np.abs(np.linalg.norm(points - (0.02, 0.01, 1.0), axis=1) - 0.09) < 0.005
    chosen = nearest_component(points, components(points, row, col), np.zeros(3), min_points=20)
    assert on_ball[chosen].mean() > 0.97
    assert len(chosen) > 0.7 * on_ball.sum()


def test_the_nearest_of_several_boxes_is_taken_and_kept():
    boxes = [box((x - 0.07, -0.1, z), (x + 0.07, 0.1, z + 0.2)) for x, z in ((-0.2, 0.95), (0.0, 0.85), (0.2, 1.0))]
    points, row, col = cast(nearest(*boxes, WALL), noise=3e-4)
    labels = components(points, row, col)
    chosen = points[nearest_component(points, labels, np.zeros(3), min_points=20)]
    assert np.abs(chosen[:, 0]).max() < 0.08
    previous = np.array([0.2, 0.0, 1.0])
    kept = points[nearest_component(points, labels, np.zeros(3), min_points=20, previous=previous)]
    assert abs(np.median(kept[:, 0]) - 0.2) < 0.03


def test_wrong_dots_do_not_join_patches():
    rng = np.random.default_rng(3)
    points, row, col = cast(nearest(sphere((0.0, 0.0, 1.0), 0.09), WALL), noise=3e-4, rng=rng)
    wrong = rng.random(len(points)) < 0.05
    points[wrong] += rng.normal(scale=0.2, size=(wrong.sum(), 3))
    labels = components(points, row, col)
    chosen = nearest_component(points, labels, np.zeros(3), min_points=20)
    distance = np.abs(np.linalg.norm(points[chosen] - (0.0, 0.0, 1.0), axis=1) - 0.09)
    assert (distance < 0.005).mean() > 0.95


def test_empty_and_tiny_clouds():
    assert components(np.zeros((0, 3))).size == 0
    assert components(np.zeros((1, 3)), np.zeros(1, int), np.zeros(1, int)).tolist() == [0]
    assert nearest_component(np.zeros((3, 3)), np.zeros(3, int), np.zeros(3), min_points=4).size == 0
    grid = np.stack([*np.meshgrid(np.arange(5.0), np.arange(4.0)), np.zeros((4, 5))], axis=-1).reshape(-1, 3)
    assert spacing(grid) == 1.0


@pytest.mark.parametrize("seed", range(6))
def test_what_stands_before_a_wall_is_parted_from_it_from_any_side(seed):
    rng = np.random.default_rng(seed)
    centre, radius = np.array([*rng.uniform(-0.05, 0.05, 2), 1.0]), rng.uniform(0.07, 0.13)
    wall = plane((0, 0, 1.0 + rng.uniform(1.0, 2.0) * radius), (*rng.uniform(-0.2, 0.2, 2), -1.0))
    points, row, col = cast(nearest(sphere(centre, radius), wall), noise=2e-4, rng=rng)
    wrong = rng.random(len(points)) < 0.03
    points[wrong] += rng.normal(scale=0.05, size=(wrong.sum(), 3))
    viewpoint = np.array([*rng.uniform(-0.4, 0.4, 2), 0.4])
    on_ball = np.abs(np.linalg.norm(points - centre, axis=1) - radius) < 3e-3
    chosen = nearest_component(points, components(points, row, col), viewpoint, min_points=20)
    assert on_ball[chosen].mean() > 0.95
    assert len(chosen) > 0.6 * (on_ball & ~wrong).sum()
