import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sl_common import transforms
from sl_sim import meshes
from sl_sim.raycast import Body, RayCaster

RADIUS = 0.3
SPHERE = RayCaster([Body(meshes.sphere(RADIUS), np.eye(4))])


@settings(max_examples=50, deadline=None)
@given(st.floats(-0.25, 0.25), st.floats(-0.25, 0.25), st.floats(0.5, 2.0))
def test_hits_of_a_sphere_are_where_geometry_says(x, y, z):
    if np.hypot(x, y) > 0.9 * RADIUS:
        return
    origin, direction = np.array([x, y, z]), np.array([[0.0, 0.0, -2.0]])
    hits = SPHERE.first_hits(origin, direction)
    expected = np.array([x, y, np.sqrt(RADIUS**2 - x * x - y * y)])
    np.testing.assert_allclose(SPHERE.points(origin, direction, hits)[0], expected, atol=3e-5)
    np.testing.assert_allclose(SPHERE.normals_at(hits)[0], expected / RADIUS, atol=2e-3)


def test_misses_are_nan_and_unlit():
    directions = np.array([[1.0, 0, 0], [0, 0, -1.0]])
    hits = SPHERE.first_hits(np.array([0.0, 0, 2.0]), directions)
    assert hits.face[0] == -1
    assert np.isnan(SPHERE.points(np.array([0.0, 0, 2.0]), directions, hits)[0]).all()
    assert np.isnan(SPHERE.normals_at(hits)[0]).all()
    assert np.isfinite(SPHERE.normals_at(hits)[1]).all()


def test_occlusion_is_blocked_only_by_what_lies_between():
    points = np.array([[0.0, 0, -1.0], [0.0, 0, RADIUS], [0.0, 0, 1.0], [2.0, 0, -1.0]])
    np.testing.assert_array_equal(SPHERE.occluded(np.array([0.0, 0, 2.0]), points), [True, False, False, False])


def test_a_moved_body_equals_one_built_there():
    wall = Body(meshes.rectangle(2, 2), np.eye(4))
    pose = transforms.make(transforms.rotation_exp(np.array([0.2, 0.4, -0.3])), np.array([0.1, -0.1, 0.4]))
    moving = RayCaster([wall, Body(meshes.box((0.2, 0.3, 0.2)), np.eye(4), moving=True)])
    version = moving.version
    moving.move(1, pose)
    assert moving.version > version
    built = RayCaster([wall, Body(meshes.box((0.2, 0.3, 0.2)), pose)])
    rng = np.random.default_rng(0)
    origin = np.array([0.1, 0.2, 2.0])
    directions = np.concatenate([rng.uniform(-0.3, 0.3, (500, 2)), np.full((500, 1), -1.0)], 1)
    first, second = moving.first_hits(origin, directions), built.first_hits(origin, directions)
    np.testing.assert_allclose(
        moving.points(origin, directions, first), built.points(origin, directions, second), atol=1e-6
    )
    np.testing.assert_allclose(moving.normals_at(first), built.normals_at(second), atol=1e-6)
    far = built.points(origin, directions, second) - [0, 0, 0.05]
    np.testing.assert_array_equal(moving.occluded(origin, far), built.occluded(origin, far))
    with pytest.raises(ValueError, match="fixed"):
        moving.move(0, pose)
