import json

import numpy as np
import pytest

from pattern_gen import default_pattern
from sl_common import transforms
from sl_common.errors import InvalidInputError, ModelError
from sl_sim import arm
from sl_sim.cell import Cell, CellSettings, inverse_kinematics
from sl_sim.scenes import NAMES, UnknownSceneError
from sl_sim.spot_truth import count_visible

PLANE = Cell(CellSettings(scene="plane"))


def denavit_hartenberg(q):
    """Flange pose of a UR5e from the maker's published parameters, independent of the URDF."""
    a = [0.0, -0.425, -0.3922, 0.0, 0.0, 0.0]
    d = [0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996]
    alpha = [np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0]
    pose = np.eye(4)
    for k in range(6):
        ct, st, ca, sa = np.cos(q[k]), np.sin(q[k]), np.cos(alpha[k]), np.sin(alpha[k])
        pose = pose @ np.array(
            [[ct, -st * ca, st * sa, a[k] * ct], [st, ct * ca, -ct * sa, a[k] * st], [0, sa, ca, d[k]], [0, 0, 0, 1]]
        )
    return pose


def test_the_urdf_has_the_published_kinematics():
    chain, rng = arm.kinematics(), np.random.default_rng(0)
    turned = transforms.make(
        np.diag([-1.0, -1.0, 1.0]), np.zeros(3)
    )  # base_link is turned about z against the maker's base
    for q in rng.uniform(-3, 3, (20, 6)):
        np.testing.assert_allclose(chain.forward(q), turned @ denavit_hartenberg(q), atol=1e-9)
    assert chain.joint_names[0] == "shoulder_pan_joint"
    np.testing.assert_allclose(chain.max_velocity, np.pi)
    np.testing.assert_allclose(chain.upper, np.array([2, 2, 1, 2, 2, 2]) * np.pi)


def test_the_capsules_follow_the_arm():
    body = arm.ArmBody(PLANE.flange_from_camera)
    q = PLANE.start_positions
    ends = body.at(q).ends
    np.testing.assert_allclose(ends[0, 0], 0, atol=1e-12)
    np.testing.assert_allclose(ends[-2, 1], arm.kinematics().forward(q)[:3, 3], atol=1e-9)
    for first, second in ((0, 1), (1, 2), (2, 3), (4, 5), (5, 6), (6, 7)):
        np.testing.assert_allclose(ends[first, 1], ends[second, 0], atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_the_start_pose_sees_hundreds_of_spots_in_every_scene(name):
    cell, pattern = Cell(CellSettings(scene=name)), default_pattern()
    pose = cell.base_from_camera(cell.start_positions)
    place = (cell.caster, cell.camera, pose, cell.projector, cell.base_from_projector)
    assert count_visible(*place, pattern.centers) > 400
    occluders = arm.ArmBody(cell.flange_from_camera).at(cell.start_positions)
    for end, radius in zip(occluders.ends, occluders.radii, strict=True):  # the arm clears the object and the wall
        assert end[:, 0].max() + radius < cell.base_from_object[0, 3] - 0.2


def test_a_cell_is_rebuilt_from_its_truth_after_json():
    first = Cell(CellSettings(scene="sphere", seed=5, sway=(0.0, 0.02, 0.0)))
    second = Cell(CellSettings(**json.loads(json.dumps(first.truth()))["cell"]))
    assert second.settings == first.settings
    np.testing.assert_array_equal(first.base_from_projector, second.base_from_projector)
    np.testing.assert_array_equal(first.flange_from_camera, second.flange_from_camera)
    np.testing.assert_array_equal(first.start_positions, second.start_positions)
    other = Cell(CellSettings(scene="sphere", seed=6))
    assert np.abs(first.base_from_projector - other.base_from_projector).max() > 1e-4
    assert np.abs(first.flange_from_camera - other.flange_from_camera).max() > 1e-4


def test_truth_of_the_surface_and_of_spots_agree():
    pose = PLANE.base_from_camera(PLANE.start_positions)
    pixels = np.array([[100.0, 100], [320, 240], [500, 400]])
    points, normals = PLANE.surface_along(pose, pixels)
    np.testing.assert_allclose(points[:, 0], PLANE.base_from_object[0, 3], atol=1e-6)
    np.testing.assert_allclose(normals, np.tile([-1.0, 0, 0], (3, 1)), atol=1e-6)
    seen = PLANE.camera.project(transforms.apply(transforms.inverse(pose), points))
    np.testing.assert_allclose(seen, pixels, atol=1e-3)
    spots, spot_normals = PLANE.spots_in_base(np.array([[500.0, 300.0]]))
    np.testing.assert_allclose(spot_normals, [[-1.0, 0, 0]], atol=1e-6)
    back = PLANE.projector.project(transforms.apply(transforms.inverse(PLANE.base_from_projector), spots))
    np.testing.assert_allclose(back, [[500.0, 300.0]], atol=1e-2)
    rays = PLANE.camera.rays(pixels) @ pose[:3, :3].T
    np.testing.assert_array_equal(PLANE.surface_along_rays(pose[:3, 3], rays)[0], points)


def test_a_moving_object_starts_at_rest_and_takes_its_surface_along():
    cell = Cell(CellSettings(scene="sphere", sway=(0.0, 0.03, 0.0), swing=5.0, sway_period=4.0))
    times = np.linspace(0, 8, 1601)
    path = np.array([cell.base_from_object_at(t)[:3, 3] for t in times])
    np.testing.assert_array_equal(path[0], cell.base_from_object[:3, 3])
    velocity = np.diff(path, axis=0) / 0.005
    assert np.abs(velocity[0]).max() < 1e-6
    assert np.abs(np.diff(velocity, axis=0) / 0.005).max() < 0.3
    assert np.ptp(path[800:, 1]) == pytest.approx(0.06, rel=1e-3)
    moved = transforms.make(np.eye(3), np.array([0.0, 0.03, 0.0])) @ cell.base_from_object
    pose = cell.base_from_camera(cell.start_positions)
    middle = cell.camera.project(transforms.apply(transforms.inverse(pose), cell.base_from_object[None, :3, 3]))
    still, _ = cell.surface_along(pose, middle)
    shifted_pose = transforms.make(np.eye(3), np.array([0.0, 0.03, 0.0])) @ pose
    shifted, _ = cell.surface_along(shifted_pose, middle, base_from_object=moved)
    np.testing.assert_allclose(shifted - still, [[0, 0.03, 0]], atol=1e-5)
    again, _ = cell.surface_along(pose, middle)
    np.testing.assert_array_equal(again, still)


def test_bad_settings_say_what_is_wrong():
    with pytest.raises(UnknownSceneError, match="teapot"):
        Cell(CellSettings(scene="teapot"))
    with pytest.raises(InvalidInputError, match="object_position"):
        CellSettings(object_position=(1.0, 2.0))
    with pytest.raises(ModelError, match="out of the arm's reach"):
        Cell(CellSettings(scene="plane", object_position=(3.0, 0.0, 0.4)))
    with pytest.raises(InvalidInputError, match="does not move"):
        PLANE.place_object(np.eye(4))


def test_inverse_kinematics_reaches_what_the_arm_can():
    chain, rng = arm.kinematics(), np.random.default_rng(2)
    for _ in range(10):
        q = PLANE.start_positions + rng.uniform(-0.3, 0.3, 6)
        found = inverse_kinematics(chain, chain.forward(q), PLANE.start_positions)
        np.testing.assert_allclose(chain.forward(found), chain.forward(q), atol=1e-9)
