import numpy as np

from sl_common.cameras import CameraModel
from sl_sim import interreflection, meshes
from sl_sim.light import aimed_projector
from sl_sim.raycast import Body, RayCaster

PROJECTOR = CameraModel(256, 192, np.array([[470.0, 0, 127.5], [0, 470.0, 95.5], [0, 0, 1.0]]))


def test_bounced_light_on_a_parallel_patch_matches_the_integral():
    """A lit rectangle faces a small receiver beside the beam: irradiance by direct integration of Lambert's law."""
    pose = aimed_projector(PROJECTOR, np.array([0.0, 0.0, 1.0]), np.zeros(3), up=np.array([0.0, 1.0, 0.0]))
    caster = RayCaster([Body(meshes.rectangle(4, 4, albedo=(0.5,) * 3), np.eye(4))])
    points = np.array([[[0.5, 0.0, 0.5]]], np.float32)
    normals = np.array([[[0.0, 0.0, -1.0]]], np.float32)
    moved = interreflection.transfer(caster, PROJECTOR, pose, 0.0, points, normals, np.zeros((1, 1), np.int32), 1)
    got = interreflection.irradiance(np.ones((192, 256, 3), np.float32), moved)[0, 0]
    half_x, half_y = 128 / 470, 96 / 470
    x, y = np.meshgrid(
        (np.arange(400) + 0.5) / 400 * 2 * half_x - half_x, (np.arange(300) + 0.5) / 300 * 2 * half_y - half_y
    )
    d2 = (x - 0.5) ** 2 + y**2 + 0.25
    # the wall facing the projector at 1 m is lit with irradiance 1; radiosity 0.5; both cosines are 0.5 / distance
    expected = (0.5 * 0.25 / (np.pi * d2**2)).sum() * (4 * half_x * half_y / x.size)
    np.testing.assert_allclose(got, expected, rtol=0.02)
