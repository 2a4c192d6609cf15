"""The paper's neighbour graph: the mixture finds both directions, and links follow them."""

import numpy as np
import pytest

from sl_decoder import graph, orientation
from sl_decoder.lattice import HEXAGONAL, SQUARE
from sl_decoder.nearest import nearest


@pytest.mark.parametrize("phase", [0.1, 1.5, 3.0, 5.8])
def test_the_mixture_finds_both_directions_whatever_it_starts_from(phase: float) -> None:
    rng = np.random.default_rng(0)
    first = np.mod(rng.vonmises(0.0, 8.0, 3000) + phase, 2 * np.pi)
    second = np.mod(rng.vonmises(0.0, 4.0, 3000) + phase + 2.8, 2 * np.pi)
    swapped = np.r_[second[:900], first[900:]], np.r_[first[:900], second[900:]]  # three in ten start wrong
    histogram = np.stack([np.histogram(a, orientation.BINS, (0, 2 * np.pi))[0] for a in swapped]).astype(float)
    found = orientation.separate(histogram)
    assert np.angle(np.exp(1j * (np.array(found) - [phase, phase + 2.8]))) == pytest.approx([0, 0], abs=0.1)


@pytest.mark.parametrize("lattice", [SQUARE, HEXAGONAL], ids=["square", "hexagonal"])
@pytest.mark.parametrize("angle", [0.0, 0.4, 1.3])
def test_links_lead_to_the_neighbours_though_dots_are_missing_and_displaced(lattice, angle: float) -> None:
    rng = np.random.default_rng(1)
    v, u = (a.ravel() for a in np.mgrid[:14, :16])
    plane = np.stack([u, v], 1) if lattice is SQUARE else np.stack([u * np.sqrt(3) / 2, v + 0.5 * u], 1)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    affine = 10.0 * np.diag([1.0, 0.7]) @ turn
    kept = rng.random(len(plane)) > 0.1
    points = (plane @ affine.T + 50 + rng.normal(0, 0.8, plane.shape))[kept].astype(np.float32)
    metric = affine @ affine.T / 70
    shape = np.tile(np.array([metric[0, 0], metric[0, 1], metric[1, 1]], np.float32), (len(points), 1))
    found, quality = orientation.links(points, shape, nearest(points, graph.NEIGHBOURS), lattice.directions)
    cell = np.stack([u, v], 1)[kept]
    step = cell[found] - cell[:, None]
    right = (step[:, :, None] == lattice.steps).all(-1).any(-1)
    inner = ((cell > 0) & (cell < [15, 13])).all(1)
    assert right[inner & np.isfinite(quality)][found[inner & np.isfinite(quality)] >= 0].mean() > 0.9
    assert np.isfinite(quality[inner]).mean() > 0.95


def test_few_points_do_no_harm() -> None:
    for n in range(1, 4):
        points = np.random.default_rng(n).uniform(0, 50, (n, 2)).astype(np.float32)
        near = np.full((n, graph.NEIGHBOURS), -1, np.int32)
        found, quality = orientation.links(points, np.tile(np.float32([1, 0, 1]), (n, 1)), near, 4)
        assert (found == -1).all()
        assert np.isinf(quality).all()


@pytest.mark.parametrize("lattice", [SQUARE, HEXAGONAL], ids=["square", "hexagonal"])
def test_no_link_skips_a_missing_dot(lattice) -> None:
    v, u = (a.ravel() for a in np.mgrid[:9, :11])
    plane = np.stack([u, v], 1) if lattice is SQUARE else np.stack([u * np.sqrt(3) / 2, v + 0.5 * u], 1)
    kept = (u != 5) | (v != 4)
    points = (10.0 * plane + 20)[kept].astype(np.float32)
    shape = np.tile(np.float32([1, 0, 1]), (len(points), 1))
    found, _ = orientation.links(points, shape, nearest(points, graph.NEIGHBOURS), lattice.directions)
    length = np.linalg.norm(points[found] - points[:, None], axis=-1)[found >= 0]
    assert length == pytest.approx(10.0, rel=1e-5)
    around = (np.linalg.norm(points - 10.0 * plane[~kept] - 20, axis=1) < 11).nonzero()[0]
    assert len(around) == lattice.directions
    assert ((found[around] >= 0).sum(1) == lattice.directions - 1).all()
