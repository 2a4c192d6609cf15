"""Measures of all elements at once are those of one element after the other."""

import numpy as np
import pytest

from sl_decoder.growth import FULL, UNPREDICTED, lattice_error, predict
from sl_decoder.lattice import HEXAGONAL, SQUARE, Lattice
from sl_decoder.measures import Measures, index_of, measure

ROWS, COLS = 9, 13


def scene(lattice: Lattice, missing: float) -> tuple[np.ndarray, ...]:
    """claim, centre, area, covariance, log_p and letters of a noisy lattice of which a share is missing."""
    rng = np.random.default_rng(3)
    claim = np.full((ROWS, COLS), -1, np.int32)
    held = rng.random((ROWS, COLS)) >= missing
    claim[held] = rng.permutation(held.sum())
    v, u = np.nonzero(held)
    basis = np.array([[11.0, 1.5], [-2.0, 12.0]] if lattice is SQUARE else [[11.0, 1.5], [4.0, 11.0]])
    centre = np.empty((held.sum(), 2), np.float32)
    centre[claim[held]] = np.stack([u, v], 1) @ basis + 0.002 * (u * v)[:, None] + rng.normal(0, 0.2, (len(u), 2))
    area = rng.integers(15, 25, len(u)).astype(np.int32)
    covariance = (np.array([4.0, 0.5, 3.0]) * rng.uniform(0.8, 1.2, (len(u), 3))).astype(np.float32)
    log_p = rng.normal(0, 3, (len(u), 4)).astype(np.float32)
    return claim, centre, area, covariance, log_p, rng.integers(0, 4, claim.shape).astype(np.int8)


def around(claim: np.ndarray, v: int, u: int) -> np.ndarray:
    """Dots of the held elements around one."""
    block = claim[max(0, v - 1) : v + 2, max(0, u - 1) : u + 2]
    return block[(block >= 0) & (block != claim[v, u])]


@pytest.mark.parametrize("lattice", [SQUARE, HEXAGONAL])
@pytest.mark.parametrize("missing", [0.0, 0.1, 0.6])
def test_measures_of_all_at_once(lattice: Lattice, missing: float) -> None:
    claim, centre, area, covariance, log_p, letters = scene(lattice, missing)
    found: Measures = measure(claim, len(centre), centre, area, covariance, log_p, letters, lattice.steps)
    assert found.held.sum() == (claim >= 0).sum()
    density = np.full(len(centre), np.nan)
    for v, u in np.argwhere(claim >= 0):
        i, k = claim[v, u], index_of(v, u, COLS)
        x, y, kind, *basis = predict(claim, centre, v, u, lattice.steps)
        assert found.kind[k] == kind
        assert found.letter[k] == log_p[i, letters[v, u]]
        if kind == UNPREDICTED:
            assert found.error[k] == 1.0
            continue
        error = lattice_error(centre[i, 0] - x, centre[i, 1] - y, *basis)
        assert found.error[k] == pytest.approx(min(error, 1.0), abs=2e-5)
        density[i] = np.log(area[i] / (basis[0] * basis[3] - basis[1] * basis[2]))
    for v, u in np.argwhere(claim >= 0):
        i, k = claim[v, u], index_of(v, u, COLS)
        others = around(claim, v, u)
        known = others[np.isfinite(density[others])]
        usual = density[known].mean() if len(known) and np.isfinite(density[i]) else np.nan
        assert found.size[k] == pytest.approx(np.nan_to_num(density[i] - usual), abs=1e-4)
        assert np.isnan(found.thin[k]) == (len(others) < 2)
        if len(others) >= 2:
            a, b, c = covariance[others].mean(0)
            ratio = np.linalg.solve([[a, b], [b, c]], covariance[i][[[0, 1], [1, 2]]])
            assert found.thin[k] == pytest.approx(np.log(np.linalg.eigvals(ratio).real.min()), abs=1e-3)
    assert (missing > 0) or (found.kind[found.held > 0] == FULL).sum() == (ROWS - 2) * (COLS - 2)
