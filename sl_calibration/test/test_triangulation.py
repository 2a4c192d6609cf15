import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sl_calibration.triangulation import Rejection, TriangulationOptions, camera_from_projector, triangulate
from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError

PROJECTOR = CameraModel(1024, 768, np.array([[2000.0, 0, 514.5], [0, 2000, 698.9], [0, 0, 1]]))
LENSES = {
    "none": (),
    "pers": (1.1,),
    "plumb_bob": (-0.25, 0.07, 1e-3, -5e-4, 0.0),
}


def camera(model="none"):
    return CameraModel(640, 480, np.array([[820.0, 0, 325.3], [0, 815, 236.8], [0, 0, 1]]), model, LENSES[model])


def scene(seed=0, count=400, model="none"):
    """A camera, camera_from_projector, points in the camera frame and their exact pixels in both images."""
    rng = np.random.default_rng(seed)
    offset = rng.uniform(0.15, 0.5) * np.array([np.cos(seed), np.sin(seed), 0.2])
    extrinsics = transforms.look_at(offset, [0.0, 0.0, 1.2], rng.normal(size=3))
    points = np.column_stack([rng.uniform(-0.25, 0.25, (count, 2)), rng.uniform(0.9, 1.5, count)])
    model = camera(model)
    seen = PROJECTOR.project(transforms.apply(transforms.inverse(extrinsics), points))
    return model, extrinsics, points, model.project(points), seen


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), lens=st.sampled_from(sorted(LENSES)))
def test_exact_pixels_give_the_exact_points(seed, lens):
    model, extrinsics, points, seen, projected = scene(seed, 60, lens)
    result = triangulate(model, PROJECTOR, extrinsics, seen, projected)
    assert result.valid.all()
    np.testing.assert_allclose(result.points, points, atol=1e-8)
    assert np.all(result.epipolar_distance < 1e-6)


def test_the_correction_is_the_best_estimate_on_the_projector_ray():
    model, extrinsics, _, seen, projected = scene(3, 2000)
    noise = np.random.default_rng(1).normal(scale=0.1, size=seen.shape)
    result = triangulate(model, PROJECTOR, extrinsics, seen + noise, projected)
    # The projector's rays are exact: the points must lie on them ...
    again = PROJECTOR.project(transforms.apply(transforms.inverse(extrinsics), result.points[result.valid]))
    np.testing.assert_allclose(again, projected[result.valid], atol=2e-3)
    # ... and no depth along the ray comes closer to the pixel measured.
    rays = transforms.apply(extrinsics, PROJECTOR.rays(projected)) - extrinsics[:3, 3]
    found = np.linalg.norm(model.project(result.points) - (seen + noise), axis=-1)
    for step in (-1e-4, 1e-4):
        other = np.linalg.norm(model.project(result.points + step * rays) - (seen + noise), axis=-1)
        assert np.all((found <= other + 1e-6)[result.valid])


def test_wrong_codes_are_refused_as_epipolar_outliers():
    model, extrinsics, _, seen, projected = scene(5, 500)
    wrong = projected.copy()
    wrong[:50] += [170.0, 119.0]
    result = triangulate(model, PROJECTOR, extrinsics, seen, wrong)
    assert result.counts()["epipolar"] >= 45
    assert result.valid[50:].all()
    assert np.isnan(result.points[~result.valid]).all()
    assert sum(result.counts().values()) == 500


def test_points_behind_the_camera_are_refused():
    model, extrinsics, points, *_ = scene(2, 100)
    behind = points * [1, 1, -1]
    pixels = behind[:, :2] / behind[:, 2:] @ np.diag([820.0, 815]) + [325.3, 236.8]
    in_projector = transforms.apply(transforms.inverse(extrinsics), behind)
    projected = in_projector[:, :2] / in_projector[:, 2:] * 2000 + [514.5, 698.9]
    result = triangulate(model, PROJECTOR, extrinsics, pixels, projected)
    assert not result.valid.any()
    assert result.counts()["behind"] > 90


def test_depths_outside_the_limits_are_refused():
    model, extrinsics, points, seen, projected = scene(2, 300)
    result = triangulate(
        model, PROJECTOR, extrinsics, seen, projected, TriangulationOptions(min_depth=1.0, max_depth=1.3)
    )
    inside = (points[:, 2] > 1.0) & (points[:, 2] < 1.3)
    np.testing.assert_array_equal(result.valid, inside)


def test_parallel_rays_are_refused():
    extrinsics = transforms.make(np.eye(3), [0.3, 0.0, 0.0])
    far = np.array([[0.0, 0.0, 100.0], [0.0, 0.0, 1.0]])
    model = camera()
    projected = PROJECTOR.project(far - [0.3, 0, 0])
    result = triangulate(model, PROJECTOR, extrinsics, model.project(far), projected)
    assert result.rejection.tolist() == [Rejection.PARALLEL, Rejection.NONE]


def test_pixels_that_are_not_finite_are_refused_alone():
    model, extrinsics, _, seen, projected = scene(4, 20)
    seen[3] = np.nan
    projected[7, 1] = np.inf
    result = triangulate(model, PROJECTOR, extrinsics, seen, projected)
    assert np.flatnonzero(result.rejection == Rejection.NOT_FINITE).tolist() == [3, 7]
    assert result.valid.sum() == 18


def test_no_dots_give_no_points():
    result = triangulate(
        camera(), PROJECTOR, transforms.make(np.eye(3), [0.3, 0, 0]), np.empty((0, 2)), np.empty((0, 2))
    )
    assert result.points.shape == (0, 3)
    assert sum(result.counts().values()) == 0


def test_extrinsics_chain_the_calibrated_transforms():
    rng = np.random.default_rng(0)
    base_from_flange, flange_from_camera, base_from_projector = transforms.exp(rng.normal(size=(3, 6)))
    result = camera_from_projector(base_from_flange, flange_from_camera, base_from_projector)
    np.testing.assert_allclose(base_from_flange @ flange_from_camera @ result, base_from_projector, atol=1e-12)


@pytest.mark.parametrize(
    ("extrinsics", "message"),
    [
        (np.eye(4), "0 m apart"),
        (np.diag([1.0, 1, -1, 1]), "not a rigid transform"),
        (np.full((4, 4), np.nan), "not a rigid transform"),
    ],
)
def test_unusable_extrinsics_are_named(extrinsics, message):
    with pytest.raises(InvalidInputError, match=message):
        triangulate(camera(), PROJECTOR, extrinsics, np.zeros((1, 2)), np.zeros((1, 2)))


def test_arrays_of_different_length_are_named():
    with pytest.raises(InvalidInputError, match="2 camera pixels but 1 projector pixels"):
        triangulate(camera(), PROJECTOR, transforms.make(np.eye(3), [1, 0, 0]), np.zeros((2, 2)), np.zeros((1, 2)))


@pytest.mark.parametrize(
    "options", [{"max_epipolar_distance": 0.0}, {"min_depth": 2.0, "max_depth": 1.0}, {"camera_sigma": 0.0}]
)
def test_options_that_make_no_sense_are_refused(options):
    with pytest.raises(InvalidInputError):
        TriangulationOptions(**options)
