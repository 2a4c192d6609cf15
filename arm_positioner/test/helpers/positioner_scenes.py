"""Synthetic scenes of dots on surfaces, with rows and columns as a projector would give them."""

import numpy as np

PROJECTOR = np.array([0.3, 0.25, 0.0])


def cast(surface, rows=40, cols=52, pitch=0.014, noise=0.0, rng=None):
    """Cast a grid of projector rays at ``surface``: origin, directions (N, 3) -> depth (N,), NaN where it misses.

    The projector stands at PROJECTOR and looks along +z. Returns points (N, 3), row (N,), col (N,);
    noise is along the rays.
    """
    row, col = (a.ravel() for a in np.mgrid[0:rows, 0:cols])
    directions = np.stack([pitch * (col - cols / 2) - 0.3, pitch * (row - rows / 2) - 0.25, np.ones(row.size)], axis=1)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    depth = surface(PROJECTOR, directions)
    if noise:
        depth = depth + noise * (rng or np.random.default_rng(0)).normal(size=depth.size)
    hit = np.isfinite(depth)
    return (PROJECTOR + depth[:, None] * directions)[hit], row[hit], col[hit]


def plane(point, normal):
    def surface(origin, directions):
        depth = (np.asarray(point) - origin) @ np.asarray(normal) / (directions @ np.asarray(normal))
        return np.where(depth > 0, depth, np.nan)

    return surface


def sphere(centre, radius):
    def surface(origin, directions):
        oc = origin - np.asarray(centre)
        b = directions @ oc
        d = b * b - (oc @ oc - radius**2)
        return np.where(d > 0, -b - np.sqrt(np.maximum(d, 0)), np.nan)

    return surface


def box(low, high):
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)

    def surface(origin, directions):
        with np.errstate(divide="ignore"):
            a, b = (low - origin) / directions, (high - origin) / directions
        near, far = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
        return np.where((near < far) & (near > 0), near, np.nan)

    return surface


def nearest(*surfaces):
    def surface(origin, directions):
        depth = np.stack([np.where(np.isnan(d := s(origin, directions)), np.inf, d) for s in surfaces])
        best = depth.min(axis=0)
        return np.where(np.isfinite(best), best, np.nan)

    return surface
