import numpy as np
import pytest
from brute_force import centroid
from hypothesis import given, settings
from hypothesis import strategies as st

from pattern_gen import Grid, Letter
from pattern_gen.errors import PatternError
from pattern_gen.pattern import fit_to_projector
from pattern_gen.rendering import coverage
from pattern_gen.shapes import SHAPES

SYMBOLS = np.arange(9 * 12).reshape(9, 12).astype(np.uint8) % 2


@pytest.mark.parametrize("grid", list(Grid))
@pytest.mark.parametrize("shape", list(SHAPES))
@pytest.mark.parametrize("diameter", [None, 5.3, 11.7])
def test_centroids_of_rendered_spots_are_the_centres(grid, shape, diameter):
    letters = (Letter((255, 255, 255), shape), Letter((140, 0, 0), shape))
    pattern = fit_to_projector(SYMBOLS, letters, grid=grid, projector_width=403, projector_height=297)
    image = pattern.render(diameter)
    assert image.shape == (297, 403, 3)
    assert image.dtype == np.uint8
    reach = int(np.ceil((diameter or pattern.spot_diameter) / 2)) + 1
    found = np.array([centroid(image, u, v, reach) for u, v in pattern.centers.reshape(-1, 2)])
    assert np.abs(found - pattern.centers.reshape(-1, 2)).max() < 0.01


@settings(max_examples=60, deadline=None)
@given(
    shape=st.sampled_from(list(SHAPES)),
    diameter=st.floats(2.0, 15.0),
    u=st.floats(0.0, 1.0),
    v=st.floats(0.0, 1.0),
)
def test_light_and_centroid_do_not_depend_on_the_sub_pixel_position(shape, diameter, u, v):
    size = int(np.ceil(diameter)) + 5
    start = 0.5 * diameter + 1.0
    patch = coverage(shape, diameter, np.array([[start + u, start + v], [start, start]]), size)
    assert patch.min() >= 0
    assert patch.max() <= 1 + 1e-12
    assert patch[0].sum() == pytest.approx(patch[1].sum(), rel=1e-9)
    rows, cols = np.mgrid[:size, :size]
    # exact for shapes that are symmetric about their centre; the triangle's strips leave 1e-4 of a pixel
    tolerance = 1e-9 if shape != "triangle" else 1e-3
    assert (patch[0] * cols).sum() / patch[0].sum() == pytest.approx(start + u, abs=tolerance)
    assert (patch[0] * rows).sum() / patch[0].sum() == pytest.approx(start + v, abs=tolerance)


def test_disc_has_the_area_of_a_disc():
    patch = coverage("disc", 9.0, np.array([[7.3, 7.8]]), 16)
    assert patch.sum() == pytest.approx(np.pi * 4.5**2, rel=2e-3)


def test_colours_are_the_letters_drive_values():
    letters = (Letter((255, 0, 7)), Letter((0, 140, 0)))
    pattern = fit_to_projector(SYMBOLS, letters, projector_width=403, projector_height=297)
    image = pattern.render()
    for (u, v), symbol in zip(pattern.centers.reshape(-1, 2), SYMBOLS.reshape(-1), strict=True):
        assert tuple(image[round(v), round(u)]) == letters[symbol].rgb


def test_shapes_differ_visibly():
    patches = {shape: coverage(shape, 10.0, np.array([[7.0, 7.0]]), 15)[0] for shape in SHAPES}
    names = list(patches)
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            assert np.abs(patches[first] - patches[second]).sum() > 8.0


def test_spots_far_smaller_than_a_pixel_and_huge_maps_render():
    pattern = fit_to_projector(
        np.zeros((400, 500), np.uint8),
        (Letter((255, 0, 0)), Letter((0, 255, 0))),
        projector_width=320,
        projector_height=240,
    )
    assert pattern.pitch < 1
    assert pattern.render().any()


@pytest.mark.parametrize("diameter", [0.0, -1.0, float("nan"), float("inf")])
def test_impossible_diameters_are_refused(diameter):
    pattern = fit_to_projector(SYMBOLS, (Letter((255, 0, 0)), Letter((0, 255, 0))))
    with pytest.raises(PatternError, match="spot_diameter"):
        pattern.render(diameter)
