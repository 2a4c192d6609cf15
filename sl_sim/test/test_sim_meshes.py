import numpy as np
import pytest

from sl_common import transforms
from sl_sim import isosurface, meshes, scenes


def volume(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def face_normals(mesh):
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


@pytest.mark.parametrize(
    ("mesh", "expected", "tolerance"),
    [
        (meshes.box((0.2, 0.3, 0.4)), 0.024, 1e-12),
        (meshes.sphere(0.1), 4 / 3 * np.pi * 1e-3, 2e-4),
        (meshes.cylinder(0.1, 0.5), np.pi * 0.01 * 0.5, 2e-4),
        (isosurface.mesh(lambda p: 0.1 - np.linalg.norm(p, axis=1), (-0.2,) * 3, (0.2,) * 3, step=0.01),
         4 / 3 * np.pi * 1e-3, 1e-2),
    ],
)  # fmt: skip
def test_closed_solids_have_their_volume_and_face_outwards(mesh, expected, tolerance):
    assert volume(mesh) == pytest.approx(expected, rel=tolerance)
    mean = mesh.normals[mesh.faces].mean(1)
    area = np.linalg.norm(face_normals(mesh), axis=1)
    outward = np.einsum("ij,ij->i", face_normals(mesh), mean)[area > 1e-9]
    assert (outward > 0).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-9)


def test_isosurface_vertices_lie_on_the_surface():
    mesh = isosurface.mesh(lambda p: 0.1 - np.linalg.norm(p, axis=1), (-0.2,) * 3, (0.2,) * 3, step=0.01)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 0.1, atol=1e-8)
    np.testing.assert_allclose(mesh.normals, mesh.vertices / 0.1, atol=1e-6)


def test_moved_and_joined_keep_geometry():
    pose = transforms.make(transforms.rotation_exp(np.array([0.3, -0.2, 0.5])), np.array([1.0, 2.0, 3.0]))
    one = meshes.box((0.1, 0.2, 0.3))
    both = meshes.join([one, meshes.sphere(0.1).moved(pose)], "both")
    assert volume(both) == pytest.approx(volume(one) + volume(meshes.sphere(0.1)))
    np.testing.assert_allclose(one.moved(pose).moved(transforms.inverse(pose)).vertices, one.vertices, atol=1e-12)


@pytest.mark.parametrize("name", scenes.NAMES)
def test_every_scene_builds_and_follows_its_seed(name):
    scene = scenes.build(name, 3)
    again, other = scenes.build(name, 3), scenes.build(name, 4)
    for (mesh, pose), (mesh2, pose2) in zip(scene.parts, again.parts, strict=True):
        np.testing.assert_array_equal(mesh.vertices, mesh2.vertices)
        np.testing.assert_array_equal(pose, pose2)
        assert np.isfinite(mesh.vertices).all()
        assert np.isfinite(mesh.normals).all()
        assert ((mesh.albedo > 0) & (mesh.albedo < 1)).all()
    same = all(
        m.vertices.shape == n.vertices.shape
        and np.array_equal(m.vertices, n.vertices)
        and np.array_equal(p, q)
        and np.array_equal(m.albedo, n.albedo)
        for (m, p), (n, q) in zip(scene.parts, other.parts, strict=True)
    )
    assert not same


def test_an_unknown_scene_lists_the_known():
    with pytest.raises(scenes.UnknownSceneError, match="bust"):
        scenes.build("teapot")
