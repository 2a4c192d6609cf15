import numpy as np
import pytest

from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_sim import meshes
from sl_sim.light import aimed_projector
from sl_sim.raycast import Body, RayCaster
from sl_sim.spot_truth import count_visible, light_up, seen, spot_truth

UP = np.array([0.0, 1.0, 0.0])
CAMERA = CameraModel(640, 480, np.array([[820.0, 0, 322.0], [0, 820.0, 238.0], [0, 0, 1.0]]))
PROJECTOR = CameraModel(1024, 768, np.array([[1900.0, 0, 510.0], [0, 1900.0, 800.0], [0, 0, 1.0]]))
POSE = aimed_projector(PROJECTOR, np.array([-0.3, 0.25, 1.0]), np.zeros(3), up=UP)
CENTERS = np.stack(np.meshgrid(np.arange(40.0, 1000, 40), np.arange(40.0, 740, 40)), -1)
WALL = Body(meshes.rectangle(4, 4), np.eye(4))


def view(x=0.2, y=-0.1, z=0.8):
    return transforms.look_at(np.array([x, y, z]), np.zeros(3), UP)


def on_the_wall(pixels):
    rays = PROJECTOR.rays(pixels) @ POSE[:3, :3].T
    return POSE[:3, 3] - rays * (POSE[2, 3] / rays[..., 2:])


def test_spots_on_a_wall_lie_where_plane_geometry_says():
    truth = spot_truth(RayCaster([WALL]), CAMERA, view(), PROJECTOR, POSE, CENTERS, 8.0)
    np.testing.assert_allclose(truth.xyz, on_the_wall(CENTERS), atol=2e-6)
    expected = CAMERA.project(transforms.apply(transforms.inverse(view()), on_the_wall(CENTERS).reshape(-1, 3)))
    np.testing.assert_allclose(truth.xy.reshape(-1, 2), expected, atol=2e-3)
    np.testing.assert_array_equal(truth.visible.ravel(), CAMERA.contains(expected))
    assert count_visible(RayCaster([WALL]), CAMERA, view(), PROJECTOR, POSE, CENTERS) == truth.visible.sum()
    np.testing.assert_allclose(truth.normal.reshape(-1, 3), np.tile([0, 0, 1.0], (CENTERS.size // 2, 1)), atol=1e-6)


def test_the_footprint_is_the_projected_disc():
    truth = spot_truth(RayCaster([WALL]), CAMERA, view(), PROJECTOR, POSE, CENTERS, 8.0)
    good = truth.visible & ~truth.edge
    angle = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    rim = CENTERS[good][:, None] + 4.0 * np.stack([np.cos(angle), np.sin(angle)], -1)
    outline = CAMERA.project(transforms.apply(transforms.inverse(view()), on_the_wall(rim).reshape(-1, 3)))
    radius = np.linalg.norm(outline.reshape(len(rim), -1, 2) - truth.xy[good][:, None], axis=-1)
    np.testing.assert_allclose(truth.axes_px[good][:, 1], 2 * radius.max(1), rtol=0.02)
    np.testing.assert_allclose(truth.axes_px[good][:, 0], 2 * radius.min(1), rtol=0.02)
    assert np.abs(truth.shift[good]).max() < 0.03  # perspective moves the centroid of so small a disc hardly at all


def test_edges_shadows_and_hidden_spots_are_told_apart():
    box = Body(meshes.box((0.12, 0.12, 0.12)), transforms.make(np.eye(3), np.array([0.0, 0.0, 0.06])))
    caster = RayCaster([WALL, box])
    truth = spot_truth(caster, CAMERA, view(), PROJECTOR, POSE, CENTERS, 8.0)
    on_box = truth.xyz[..., 2] > 0.01
    top = truth.xyz[..., 2] > 0.119
    assert on_box.any()
    inner = top & (np.abs(truth.xyz[..., :2]) < 0.05).all(-1)
    assert truth.visible[inner].all()
    assert not truth.edge[inner].any()
    rim = top & (np.abs(np.abs(truth.xyz[..., :2]) - 0.06).min(-1) < 0.0015)
    assert truth.edge[rim].all()
    # the camera is right of the box: what lies on the wall left behind it is lit but not seen
    pixels, visible = seen(caster, CAMERA, view(), truth.xyz.reshape(-1, 3))
    assert (truth.visible.ravel() <= visible).all()
    hidden = np.isfinite(pixels).all(1) & CAMERA.contains(pixels) & ~visible
    assert hidden.any()
    assert not truth.visible.ravel()[hidden].any()


def test_a_step_in_the_paint_is_an_edge():
    board = meshes.height_field(lambda x, y: 0 * x, 0.8, 0.8, step=0.002)
    board = board.painted(lambda at: np.where(at[:, :1] > 0, 0.8, 0.1))
    dense = np.stack(np.meshgrid(np.arange(300.0, 700, 2.5), np.arange(40.0, 740, 60)), -1)
    truth = spot_truth(RayCaster([Body(board, np.eye(4))]), CAMERA, view(), PROJECTOR, POSE, dense, 8.0)
    on_step = truth.visible & (np.abs(truth.xyz[..., 0]) < 0.001)
    away = truth.visible & (np.abs(truth.xyz[..., 0]) > 0.01) & (np.abs(truth.xy - [320, 240]) < [300, 220]).all(-1)
    assert on_step.any()
    assert truth.edge[on_step].all()
    assert not truth.edge[away].any()


def test_light_that_hits_nothing_is_nan():
    small = RayCaster([Body(meshes.rectangle(0.1, 0.1), np.eye(4))])
    lit = light_up(small, PROJECTOR, POSE, np.array([[40.0, 40.0], [511.5, 383.5]]))
    assert np.isnan(lit.xyz[0]).all()
    assert lit.body[0] == -1
    np.testing.assert_allclose(lit.xyz[1], 0.0, atol=1e-6)
    truth = spot_truth(small, CAMERA, view(), PROJECTOR, POSE, CENTERS, 8.0)
    missed = np.isnan(truth.xyz[..., 0])
    assert missed.any()
    assert not truth.visible[missed].any()
    assert truth.visible[~missed].any()


def test_irradiance_falls_with_the_square_of_the_distance():
    far = Body(meshes.rectangle(6, 6), transforms.make(np.eye(3), np.array([0.0, 0.0, -1.0])))
    near_truth, far_truth = (
        spot_truth(RayCaster([b]), CAMERA, view(), PROJECTOR, POSE, CENTERS[8:9, 11:12], 8.0) for b in (WALL, far)
    )
    assert near_truth.irradiance[0, 0] / far_truth.irradiance[0, 0] == pytest.approx(4.0, rel=0.01)
