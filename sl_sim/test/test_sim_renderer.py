import numpy as np
import pytest
from scipy.spatial import cKDTree

from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_sim import kernels, meshes
from sl_sim.light import LightSource, Occluders, aimed_projector
from sl_sim.projector import ProjectorOptions, light_image
from sl_sim.raycast import Body, RayCaster
from sl_sim.render_options import RenderOptions
from sl_sim.renderer import Renderer
from sl_sim.spot_truth import spot_truth

REACH = 3.7
UP = np.array([0.0, 1.0, 0.0])
CAMERA = CameraModel(160, 120, np.array([[205.0, 0, 81.0], [0, 205.0, 59.0], [0, 0, 1.0]]))
BARREL = CameraModel(160, 120, np.asarray(CAMERA.matrix), "pers", (0.7,))
PROJECTOR = CameraModel(256, 192, np.array([[470.0, 0, 127.0], [0, 470.0, 203.0], [0, 0, 1.0]]))
BASE_FROM_PROJECTOR = aimed_projector(PROJECTOR, np.array([-0.3, 0.3, 0.95]), np.zeros(3), up=UP)
SOURCE = LightSource(PROJECTOR, BASE_FROM_PROJECTOR)
PURE = ProjectorOptions(gamma=(1.0, 1.0, 1.0), crosstalk=tuple(np.eye(3)), black_level=0.0, vignetting=0.0)
PLAIN = {"ambient": 0.0, "projector_vignetting": 0.0}


def view(x=0.2, y=-0.15, z=0.8):
    return transforms.look_at(np.array([x, y, z]), np.zeros(3), UP)


def dots(pitch=14.0, diameter=7.0):
    """Antialiased white discs at sub-pixel centres, and the centres (rows, cols, 2)."""
    u, v = np.meshgrid(np.arange(10.3, 250, pitch), np.arange(8.7, 186, pitch))
    yy, xx = np.mgrid[: 192 * 8, : 256 * 8] / 8 - 0.5 + 1 / 16
    near = np.zeros(yy.shape, bool)
    for a, b in zip(u.ravel(), v.ravel(), strict=True):
        y0, x0 = int((b - 6) * 8), int((a - 6) * 8)
        part = np.s_[max(y0, 0) : y0 + 104, max(x0, 0) : x0 + 104]
        near[part] |= (xx[part] - a) ** 2 + (yy[part] - b) ** 2 < (diameter / 2) ** 2
    grey = near.reshape(192, 8, 256, 8).mean(axis=(1, 3)) * 255
    return np.repeat(np.round(grey).astype(np.uint8)[..., None], 3, 2), np.stack([u, v], -1)


def centroids(radiance, truth, reach):
    """Centroid of the light around each visible spot's true centre."""
    image, found = radiance.sum(-1), []
    rows, cols = np.mgrid[: image.shape[0], : image.shape[1]]
    for x, y in truth:
        near = (np.abs(cols - x) < reach) & (np.abs(rows - y) < reach)
        weight = image * near
        found.append([(weight * cols).sum() / weight.sum(), (weight * rows).sum() / weight.sum()])
    return np.array(found)


@pytest.mark.parametrize("camera", [CAMERA, BARREL], ids=["pinhole", "barrel"])
@pytest.mark.parametrize("samples", [2, 3])
def test_disc_centroids_are_where_the_projected_truth_says(camera, samples):
    image, centers = dots()
    caster = RayCaster([Body(meshes.rectangle(3, 3), np.eye(4))])
    renderer = Renderer(caster, camera, SOURCE, RenderOptions(samples=samples, **PLAIN))
    radiance = renderer.radiance(light_image(image, PURE), view())
    truth = spot_truth(caster, camera, view(), PROJECTOR, BASE_FROM_PROJECTOR, centers, 7.0)
    good = truth.visible & ~truth.edge & camera.contains(truth.xy + 6) & camera.contains(truth.xy - 6)
    spacing = cKDTree(truth.xy[truth.visible]).query(truth.xy[good], 2)[0][:, 1]
    good[good] = spacing > REACH + 2.6  # no neighbour's light in the window
    assert good.sum() > 40
    error = centroids(radiance, truth.xy[good], REACH) - truth.xy[good] - truth.shift[good]
    assert np.sqrt((error**2).mean()) < 0.03
    assert np.abs(error.mean(0)).max() < 0.01


def test_a_facing_white_wall_shines_by_the_inverse_square_and_lamberts_cosine():
    light = light_image(np.full((192, 256, 3), 255, np.uint8), PURE)
    facing = aimed_projector(PROJECTOR, np.array([0.0, 0.0, 1.0]), np.zeros(3), up=UP)
    level = {}
    for distance, tilt in ((1.0, 0.0), (2.0, 0.0), (1.0, 60.0)):
        turn = transforms.make(
            transforms.rotation_exp(np.array([0, np.radians(tilt), 0])), np.array([0, 0, 1 - distance])
        )
        wall = meshes.rectangle(4, 4, albedo=(0.8, 0.6, 0.4))
        renderer = Renderer(
            RayCaster([Body(wall, turn)]), CAMERA, LightSource(PROJECTOR, facing), RenderOptions(**PLAIN)
        )
        level[distance, tilt] = renderer.radiance(light, view(0.01, 0.01, 0.9))[56:62, 78:84].mean((0, 1))
    beam = PROJECTOR.rays(np.array([[127.5, 95.5]]))[0]
    axial = 1.0 / np.linalg.norm(beam)  # cosine between the beam's middle and the optical axis (lens shift)
    # at 1 m along the beam the plane is met at cosine 1; equal flux a pixel gives cosine / (axial z^2)
    np.testing.assert_allclose(level[1.0, 0.0], np.array([0.8, 0.6, 0.4]) / axial**3, rtol=0.01)
    np.testing.assert_allclose(level[2.0, 0.0], level[1.0, 0.0] / 4, rtol=0.02)
    np.testing.assert_allclose(level[1.0, 60.0], level[1.0, 0.0] / 2, rtol=0.05)


def test_what_the_projector_cannot_reach_is_dark_and_what_the_camera_cannot_see_is_absent():
    light = light_image(np.full((192, 256, 3), 255, np.uint8), PURE)
    wall = Body(meshes.rectangle(3, 3, albedo=(0.7,) * 3), np.eye(4))
    ball = Body(meshes.sphere(0.08, albedo=(0.7,) * 3), transforms.make(np.eye(3), np.array([0.0, 0, 0.2])))
    alone = Renderer(RayCaster([wall]), CAMERA, SOURCE, RenderOptions(**PLAIN)).radiance(light, view())
    both = Renderer(RayCaster([wall, ball]), CAMERA, SOURCE, RenderOptions(**PLAIN)).radiance(light, view())
    # the point where the projector's ray through the ball's middle meets the wall lies in its shadow
    source, middle = BASE_FROM_PROJECTOR[:3, 3], np.array([0.0, 0.0, 0.2])
    hidden = source + (middle - source) * source[2] / (source[2] - 0.2)
    x, y = np.round(CAMERA.project(transforms.apply(transforms.inverse(view()), hidden[None]))[0]).astype(int)
    assert alone[y, x].min() > 0.1
    assert both[y, x].max() == 0.0
    # a capsule in the place of the ball keeps the same light away
    capsule = Occluders(np.array([[middle, middle + np.array([0, 0, 1e-3])]]), np.array([0.08]))
    shaded = Renderer(RayCaster([wall]), CAMERA, SOURCE, RenderOptions(**PLAIN)).radiance(
        light, view(), occluders=capsule
    )
    assert shaded[y, x].max() == 0.0
    assert (shaded == 0).sum() < 0.5 * shaded.size


def test_no_light_no_image_and_light_adds_up():
    caster = RayCaster([Body(meshes.rectangle(3, 3), np.eye(4)), Body(meshes.box((0.2, 0.2, 0.2)), np.eye(4))])
    renderer = Renderer(caster, CAMERA, SOURCE, RenderOptions(interreflection=True, **PLAIN))
    black = light_image(np.zeros((192, 256, 3), np.uint8), PURE)
    assert renderer.radiance(black, view()).max() == 0.0
    rng = np.random.default_rng(1)
    one, two = rng.uniform(0, 1, (2, *black.shape)).astype(np.float32)
    total = renderer.radiance(one, view()) + renderer.radiance(two, view())
    np.testing.assert_allclose(renderer.radiance(one + two, view()), total, atol=1e-5)


def test_interpolation_agrees_with_tracing_every_sub_pixel(monkeypatch):
    image, _ = dots()
    light = light_image(image, PURE)
    bodies = [
        Body(meshes.rectangle(3, 3), np.eye(4)),
        Body(meshes.sphere(0.1), transforms.make(np.eye(3), np.array([0.1, 0.0, 0.1]))),
        Body(
            meshes.box((0.15, 0.2, 0.2)),
            transforms.make(transforms.rotation_exp(np.array([0.3, 0.5, 0.1])), [-0.1, 0, 0.1]),
        ),
    ]
    caster = RayCaster(bodies)
    images = {
        lattice: Renderer(caster, CAMERA, SOURCE, RenderOptions(lattice=lattice)).radiance(light, view())
        for lattice in (1, 2, 3)
    }
    monkeypatch.setattr(kernels, "uneven_cells", lambda *arguments: arguments[-1].fill(1))
    every = Renderer(caster, CAMERA, SOURCE, RenderOptions()).radiance(light, view())
    for lattice, share in ((1, 0.002), (2, 0.006), (3, 0.01)):
        difference = np.abs(images[lattice] - every).max(-1)
        assert (difference > 0.03).mean() < share
        assert difference.mean() < 0.001


def test_nothing_moved_gives_the_same_image_and_motion_another():
    image, _ = dots()
    light = light_image(image, PURE)
    ball = Body(meshes.sphere(0.1), np.eye(4), moving=True)
    caster = RayCaster([Body(meshes.rectangle(3, 3), np.eye(4)), ball])
    renderer = Renderer(caster, CAMERA, SOURCE, RenderOptions())
    first = renderer.radiance(light, view())
    np.testing.assert_array_equal(first, renderer.radiance(light, view()))
    caster.move(1, transforms.make(np.eye(3), np.array([0.05, 0, 0])))
    moved = renderer.radiance(light, view())
    assert np.abs(moved - first).max() > 0.1
    caster.move(1, np.eye(4))
    np.testing.assert_array_equal(first, renderer.radiance(light, view()))


def test_one_bounce_lights_corners_but_no_plane_and_stays_below_the_direct_light():
    light = light_image(np.full((192, 256, 3), 255, np.uint8), PURE)
    plane = [Body(meshes.rectangle(3, 3, albedo=(0.9,) * 3), np.eye(4))]
    stands = transforms.make(transforms.rotation_exp(np.array([-np.pi / 2, 0, 0])), np.array([0.0, -0.06, 0.0]))
    corner = [*plane, Body(meshes.rectangle(3, 3, albedo=(0.9,) * 3), stands)]
    for bodies, brighter in ((plane, False), (corner, True)):
        caster = RayCaster(bodies)
        pose = view(0.2, 0.4, 0.7)
        without = Renderer(caster, CAMERA, SOURCE, RenderOptions(**PLAIN)).radiance(light, pose)
        bounced = Renderer(caster, CAMERA, SOURCE, RenderOptions(interreflection=True, **PLAIN)).radiance(light, pose)
        gain = bounced - without
        assert gain.min() >= -1e-6
        assert (gain.mean() > 0.01 * without.mean()) == brighter
        assert gain.mean() < 0.9 * without.mean()


def test_the_camera_out_of_the_pupils_centre_sees_the_sharp_plane_unmoved():
    image, _ = dots()
    light = light_image(image, PURE)
    caster = RayCaster([Body(meshes.rectangle(3, 3), np.eye(4))])
    facing = view(1e-6, 0.0, 0.8)
    renderer = Renderer(caster, CAMERA, SOURCE, RenderOptions(**PLAIN))
    centre = renderer.radiance(light, facing)
    sharp = renderer.radiance(light, facing, lens_point=(0.004, 0.0), focus=0.8)
    blurred = renderer.radiance(light, facing, lens_point=(0.004, 0.0), focus=1.6)
    assert np.abs(sharp - centre).max() < 0.02
    assert np.abs(blurred - centre).max() > 0.1
