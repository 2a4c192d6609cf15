"""Dots of which a part is lost, and intensities on which neighbours agree."""

import numpy as np
import pytest
from decoder_helpers import default_pattern, project

from sl_decoder import Decoder
from sl_decoder.agreement import agreed_field
from sl_decoder.footprints import lost_at_line_end, lost_beside
from sl_decoder.lattice import SQUARE
from sl_decoder.nearest import nearest
from sl_decoder.synthetic import view

PATTERN = default_pattern()
DECODER = Decoder(PATTERN)
PITCH, RADIUS = 14.0, 4.0
HALF_SHIFT = 4 / (3 * np.pi) * RADIUS  # of half a disc's centroid
HALF_VARIANCE = RADIUS**2 / 4 - HALF_SHIFT**2


def lost_at(centre: np.ndarray, covariance: np.ndarray, v: int, u: int) -> float:
    """The lost part [px] of one of 6x6 dots, all held, by the mean of its neighbours."""
    claim = np.arange(36, dtype=np.int32).reshape(6, 6)
    around = [claim[y, x] for y in range(v - 1, min(v + 2, 6)) for x in range(u - 1, u + 2) if (y, x) != (v, u)]
    dx, dy = np.zeros(2, np.float32) if v == 5 else centre[claim[v, u]] - centre[around].mean(0)
    n0, n1, n2 = covariance[around].mean(0)
    beside = lost_beside(*covariance[claim[v, u]], n0, n1, n2, dx, dy, False)
    return float(max(beside, lost_at_line_end(claim, centre, covariance, v, u, SQUARE.steps)))


def lattice() -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[:6, :6].reshape(2, 36) * PITCH
    covariance = np.tile(np.array([RADIUS**2 / 4, 0.0, RADIUS**2 / 4], np.float32), (36, 1))
    return np.stack([x, y], 1).astype(np.float32), covariance


def test_a_displaced_dot_has_lost_a_part_if_it_is_narrower_or_its_shape_is_not_known() -> None:
    whole = np.float32([RADIUS**2 / 4, 0.0, RADIUS**2 / 4])
    place = np.float32([0.3 * RADIUS, 0.4 * RADIUS])
    assert lost_beside(*whole, *whole, *place, False) == 0.0
    assert 0.0 < lost_beside(*whole, *whole, *place, True) < 0.5 * RADIUS
    assert lost_beside(*whole, *whole, *(0.1 * place), True) == 0.0


def test_half_a_dot_amid_whole_ones_and_a_rim_of_halves_have_lost_a_part() -> None:
    centre, covariance = lattice()
    assert max(lost_at(centre, covariance, v, 3) for v in range(1, 6)) == 0.0
    centre[2 * 6 + 3, 0] += HALF_SHIFT
    covariance[2 * 6 + 3, 0] = HALF_VARIANCE
    assert lost_at(centre, covariance, 2, 3) > 0.7 * HALF_SHIFT
    centre, covariance = lattice()
    centre[30:, 1] -= HALF_SHIFT  # the whole last row, which its own neighbours do not tell from whole dots
    covariance[30:, 2] = HALF_VARIANCE
    assert lost_at(centre, covariance, 5, 3) > 0.7 * HALF_SHIFT


def test_a_surface_that_turns_away_has_lost_nothing() -> None:
    centre, covariance = lattice()
    narrowing = np.cos(np.arange(6) * np.radians(8))  # rows nearer to each other, dots flatter, alike
    centre[:, 1] = np.repeat(np.concatenate([[0], np.cumsum(PITCH * (narrowing[1:] + narrowing[:-1]) / 2)]), 6)
    covariance[:, 2] *= np.repeat(narrowing**2, 6)
    assert lost_at(centre, covariance, 5, 3) < 0.1


@pytest.mark.parametrize("scale", [0.8, 1.2])
@pytest.mark.parametrize("angle", [0.0, 0.5])
def test_dots_cut_by_an_edge_are_not_given_displaced(scale: float, angle: float) -> None:
    affine = view(PATTERN, angle=angle, scale=scale, seed=2)
    image = project(PATTERN, affine, noise=1.5)
    at = PATTERN.centers @ affine[:, :2].T + affine[:, 2]
    along = affine[:, 1] / np.linalg.norm(affine[:, 1])
    normal = np.array([along[1], -along[0]])
    radius = PATTERN.spot_diameter * scale / 2
    y, x = np.mgrid[:480, :640]
    for offset in np.linspace(-0.8, 0.8, 9):
        cut = image.copy()
        cut[(np.stack([x, y], -1) - at[20, 30] - offset * radius * normal) @ normal > 0] = 20
        decoded = DECODER.decode(cut)
        error = np.linalg.norm(decoded.camera - at[decoded.row, decoded.col], axis=1)
        assert len(decoded) > 300
        assert error.max() < 1.2


def test_neighbours_agree_on_the_intensities_of_every_patch() -> None:
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:24, :24].reshape(2, -1).astype(np.float32)
    near = nearest(np.stack([x, y], 1) * 10 + rng.uniform(-1, 1, (len(x), 2)).astype(np.float32), 12)
    group = np.array([0, 1, 2, 0, 1, 2], np.int32)
    level = np.array([0.0, 0.1, -0.1, -0.8, -0.7, -0.95], np.float32)
    true = rng.integers(0, 6, len(x))
    albedo = np.where(x < 12, 0.0, -2.1).astype(np.float32)  # one half eight times as dark
    signal = (level[true] + albedo + rng.normal(0, 0.08, len(x))).astype(np.float32)
    read = (true % 3 + 3 * rng.integers(0, 2, len(x))).astype(np.int32)  # hues right, intensities at random
    field, variance = np.zeros(len(x), np.float32), np.ones(len(x), np.float32)
    agreed_field(signal, read, np.zeros(len(x), bool), near, level, group, field, variance)
    right = np.abs(field - albedo) < 0.3
    assert right[abs(x - 11.5) > 3].mean() > 0.99
    assert right.mean() > 0.93
    assert (variance < 0.1).mean() > 0.9
    known = np.ones(len(x), bool)
    before = field.copy()
    agreed_field(signal, read, known, near, level, group, field, variance)
    assert np.array_equal(field, before)  # what is known needs nobody's agreement
