import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError

MATRIX = [[820.0, 0.0, 325.3], [0.0, 815.0, 236.8], [0.0, 0.0, 1.0]]
MODELS = {
    "none": ("none", ()),
    "pers": ("pers", (0.9,)),
    "plumb_bob": ("plumb_bob", (-0.31, 0.12, 0.0011, -0.0007, -0.02)),
    "pincushion": ("plumb_bob", (0.2, 0.05, 0.0, 0.0)),
}
pixels = st.tuples(st.floats(-0.5, 639.5), st.floats(-0.5, 479.5))


def camera(name):
    model, coefficients = MODELS[name]
    return CameraModel(640, 480, np.array(MATRIX), model, coefficients)


@pytest.mark.parametrize("name", MODELS)
@given(pixel=pixels, depth=st.floats(0.01, 100.0))
def test_projecting_a_ray_returns_its_pixel(name, pixel, depth):
    model = camera(name)
    assert model.project(depth * model.rays(pixel)) == pytest.approx(pixel, abs=1e-7)


def test_pers_is_the_formula_of_the_paper():
    model = camera("pers")
    r, f = 0.3, 0.9
    printed = -f / 2 * (np.exp(-2 * r / f) - 1) / np.exp(-r / f)
    pixel = model.to_pixels([r, 0.0])
    assert model.undistort(pixel) == pytest.approx([printed, 0.0])


@given(st.floats(1e-12, 1e-3))
def test_pers_is_smooth_at_the_centre(radius):
    model = camera("pers")
    assert model.undistort(model.to_pixels([radius, 0.0]))[0] == pytest.approx(radius, rel=1e-4)


def test_principal_point_may_lie_outside_the_image():
    matrix = np.array([[1892.0, 0, 504.0], [0, 1892.0, 856.0], [0, 0, 1]])
    projector = CameraModel(1024, 768, matrix)
    assert projector.project([0.0, 0.0, 1.0]) == pytest.approx([504.0, 856.0])
    assert not projector.contains([504.0, 856.0])


def test_points_behind_the_camera_have_no_image():
    assert np.isnan(camera("none").project([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0]])).all()


def test_pixels_beyond_the_fold_of_a_strong_barrel_have_no_ray():
    model = CameraModel(640, 480, np.array([[300.0, 0, 320], [0, 300, 240], [0, 0, 1]]), "plumb_bob", (-0.5, 0, 0, 0))
    corner, centre = model.rays([[0.0, 0.0], [330.0, 250.0]])
    assert np.isnan(corner[:2]).all()
    assert np.isfinite(centre).all()


def test_plumb_bob_fit_of_a_pers_lens_is_good_to_a_hundredth_of_a_pixel():
    model = camera("pers")
    grid = np.stack(np.meshgrid(np.arange(0.0, 640, 20), np.arange(0.0, 480, 20)), -1).reshape(-1, 2)
    assert np.abs(model.as_plumb_bob().project(model.rays(grid)) - grid).max() < 0.01


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"distortion_model": "fisheye"}, "fisheye"),
        ({"distortion_model": "pers", "coefficients": (-1.0,)}, "f > 0"),
        ({"distortion_model": "pers"}, "takes 1 coefficients, got 0"),
        ({"matrix": np.diag([0.0, 1.0, 1.0])}, "fx 0"),
        ({"matrix": np.full((3, 3), np.nan)}, "finite"),
        ({"width": 0}, "0x480"),
    ],
)
def test_unusable_models_are_refused_with_the_reason(changes, reason):
    arguments = {"width": 640, "height": 480, "matrix": np.array(MATRIX)} | changes
    with pytest.raises(InvalidInputError, match=reason):
        CameraModel(**arguments)
