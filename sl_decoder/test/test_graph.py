"""Neighbour graph: links, components and lattice coordinates under affine views."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sl_decoder import graph
from sl_decoder.lattice import HEXAGONAL, SQUARE
from sl_decoder.nearest import MOST, nearest


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 1000), n=st.integers(1, 120), k=st.sampled_from([4, 12]))
def test_nearest_agrees_with_brute_force(seed: int, n: int, k: int) -> None:
    points = np.random.default_rng(seed).uniform(0, 100, (n, 2)).astype(np.float32) * np.array([1, 0.3], np.float32)
    near = nearest(points, k)
    distance = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    for i in range(n):
        want = np.sort(distance[i])[: min(k, n - 1)]
        got = distance[i, near[i][near[i] >= 0]]
        assert got == pytest.approx(want, abs=1e-3)


def linked(lattice, angle: float, squeeze: float, rng: np.random.Generator):
    v, u = (a.ravel() for a in np.mgrid[:14, :16])
    if lattice is SQUARE:
        plane = np.stack([u, v], 1).astype(float)
    else:
        plane = np.stack([u * np.sqrt(3) / 2, v + 0.5 * u], 1)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    other = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    affine = 10.0 * other @ np.diag([1.0, squeeze]) @ turn
    points = (plane @ affine.T + 200 + rng.normal(0, 0.15, plane.shape)).astype(np.float32)
    shape = affine @ affine.T * (8 / 17) ** 2 / 16 + 0.4 * np.eye(2)
    covariance = np.tile(np.array([shape[0, 0], shape[0, 1], shape[1, 1]], np.float32), (len(points), 1))
    near = nearest(points, graph.NEIGHBOURS)
    links = np.empty((len(points), lattice.directions), np.int32)
    quality = np.empty(len(points), np.float32)
    graph.local_bases(
        points,
        graph.smooth_shapes(covariance, near, graph.BLUR),
        near,
        lattice.directions,
        graph.TOLERANCE,
        links,
        quality,
    )
    component, frame, cu, cv = (np.empty(len(points), np.int32) for _ in range(4))
    count, conflicts = graph.components(links, quality, lattice.steps, component, frame, cu, cv)
    return u, v, component, cu, cv, conflicts, count


@pytest.mark.parametrize("lattice", [SQUARE, HEXAGONAL])
@pytest.mark.parametrize("squeeze", [1.0, 0.6, 0.5])
def test_a_lattice_seen_obliquely_is_one_component_with_right_coordinates(lattice, squeeze: float) -> None:
    rng = np.random.default_rng(3)
    for angle in rng.uniform(0, 2 * np.pi, 5):
        u, v, component, cu, cv, conflicts, _ = linked(lattice, angle, squeeze, rng)
        main = np.bincount(component[component >= 0]).argmax()
        inside = (component == main) & ~conflicts
        assert inside.mean() > 0.9
        inner = (u > 0) & (v > 0) & (u < u.max()) & (v < v.max())  # growth completes the rim
        assert inside[inner].mean() > 0.97
        # the coordinates differ from the true ones by one rotation of the lattice and a shift
        for turn in lattice.turn:
            turned = turn @ np.stack([cu[inside], cv[inside]])
            shift = np.stack([u[inside], v[inside]]) - turned
            if (shift == shift[:, :1]).all():
                break
        else:
            pytest.fail("no rotation of the lattice explains the coordinates")


def test_few_points_do_no_harm() -> None:
    for n in range(4):
        points = np.random.default_rng(n).uniform(0, 50, (n, 2)).astype(np.float32)
        assert nearest(points, 8).shape == (n, 8)


def test_more_neighbours_than_are_kept_are_refused() -> None:
    with pytest.raises(ValueError, match="neighbours"):
        nearest(np.zeros((20, 2), np.float32), MOST + 1)
