"""The object of interest in an unordered cloud: the nearest coherent patch of dots.

Dots that are neighbours in the projected pattern are neighbours on the surface, unless the surface breaks between them.
A break shows as a gap that is long against the spacing of the dots around it (light that grazes a surface does not come
back), or as a step that neither side continues into. Only points with several unbroken edges join patches.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

_LONGEST_EDGE = 3.5
"""Edges longer than this multiple of the local spacing are gaps; a surface tilted by 70 degrees stretches them by 3."""
_WINDOW = 3
"""Rows and columns around a dot from which its spacing is judged: more than the rim of an object is wide."""
_CORE = 4
"""Unbroken edges, of eight, from which on a point may join patches."""
_STEP = 0.6
"""Steps higher than this share of the local spacing, missed by the extrapolation from both sides, are breaks."""


def components(points: Array, row: NDArray | None = None, col: NDArray | None = None) -> Indices:
    """Label the coherent patches of a cloud.

    Args:
        points: (N, 3) finite points [m].
        row: (N,) row of each dot in the pattern, or None: neighbours are then found by distance alone.
        col: (N,) column of each dot.

    Returns labels (N,), 0 for the largest patch, 1 for the next and so on.
    """
    n = len(points)
    if n == 0:
        return np.zeros(0, dtype=np.int64)
    edges = _near_edges(points) if row is None or col is None else _map_edges(points, row, col)
    core = np.bincount(edges.ravel(), minlength=n) >= _CORE
    labels = _connected(edges[core[edges].all(axis=1)], n)
    # the others belong to a core beside them, or to nobody
    for a, b in (edges.T, edges.T[::-1]):
        rim = ~core[a] & core[b]
        labels[a[rim]] = labels[b[rim]]
    sizes = np.bincount(labels)
    rank = np.empty(len(sizes), dtype=np.int64)
    rank[np.argsort(-sizes, kind="stable")] = np.arange(len(sizes))
    return rank[labels]


def _connected(edges: Indices, n: int) -> Indices:
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(n, n))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)


def nearest_component(
    points: Array, labels: Indices, viewpoint: Array, *, min_points: int, previous: Array | None = None
) -> Indices:
    """Return the indices of the patch of interest.

    Args:
        points: (N, 3) [m].
        labels: (N,) from :func:`components`.
        viewpoint: (3,) the camera's position [m].
        min_points: Smaller patches do not count.
        previous: (3,) surface point of the object chosen before [m]; the patch next to it is then taken again.

    Returns an empty array where no patch is large enough.
    """
    sizes = np.bincount(labels) if labels.size else np.zeros(0, dtype=np.int64)
    best, best_distance = -1, np.inf
    for label in np.flatnonzero(sizes >= min_points):
        patch = points[labels == label]
        if previous is None:
            distance = float(np.quantile(np.linalg.norm(patch - viewpoint, axis=1), 0.2))
        else:
            distance = float(np.quantile(np.linalg.norm(patch - previous, axis=1), 0.05))
        if distance < best_distance:
            best, best_distance = int(label), distance
    return np.flatnonzero(labels == best)


def spacing(points: Array) -> float:
    """Return the median distance of points (N, 3) to their nearest neighbour [m]."""
    distance, _ = cKDTree(points).query(points, k=2)
    return float(np.median(distance[:, 1]))


def _near_edges(points: Array) -> Indices:
    """Return the edges (M, 2) between near points, each once."""
    k = min(9, len(points))
    if k < 2:
        return np.zeros((0, 2), dtype=np.int64)
    distance, index = cKDTree(points).query(points, k=k)
    scale = distance[:, min(4, k - 1)]
    a, b, length = np.repeat(np.arange(len(points)), k - 1), index[:, 1:].ravel(), distance[:, 1:].ravel()
    keep = length <= _LONGEST_EDGE * np.minimum(scale[a], scale[b])
    return np.unique(np.sort(np.stack([a[keep], b[keep]], axis=1), axis=1), axis=0)


def _map_edges(points: Array, row: NDArray, col: NDArray) -> Indices:
    """Return the edges (M, 2) between neighbours in row, column and diagonal that no break cuts."""
    row, col = np.asarray(row, dtype=np.int64), np.asarray(col, dtype=np.int64)
    grid = np.full((row.max() + 7, col.max() + 7), -1, dtype=np.int64)
    grid[row + 3, col + 3] = np.arange(len(points))  # a margin of three spares all border checks
    scale = _spacing_around(points, row, col, grid)
    found = []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        at = [grid[row + 3 + s * dr, col + 3 + s * dc] for s in (-1, 1, 2)]
        a = np.flatnonzero(at[1] >= 0)
        before, b, after = (index[a] for index in at)
        length = np.linalg.norm(points[b] - points[a], axis=1)
        size = np.minimum(scale[a], scale[b]) * np.hypot(dr, dc)
        miss = np.fmin(_second_difference(points, before, a, b), _second_difference(points, a, b, after))
        keep = (length <= _LONGEST_EDGE * size) & ~(miss > _STEP * np.maximum(size, length / 2))
        found.append(np.stack([a[keep], b[keep]], axis=1))
    return np.concatenate(found)


def _spacing_around(points: Array, row: Indices, col: Indices, grid: Indices) -> Array:
    """Return the lower quartile (N,) of the distances between neighbouring dots in a window around each [m].

    At the rim of an object the surface turns away and the dots move apart; the quartile of a window wider than the rim
    still is the spacing on the face, which any step has to be compared with.
    """
    steps = np.full((2, *grid.shape), np.nan)
    for k, (dr, dc) in enumerate(((0, 1), (1, 0))):
        neighbour = grid[row + 3 + dr, col + 3 + dc]
        steps[k, row + 3, col + 3] = np.where(
            neighbour >= 0, np.linalg.norm(points - points[neighbour], axis=1), np.nan
        )
    padded = np.pad(steps, ((0, 0), (_WINDOW, _WINDOW), (_WINDOW, _WINDOW)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (2 * _WINDOW + 1, 2 * _WINDOW + 1), axis=(1, 2))
    near = np.sort(windows[:, row + 3, col + 3].transpose(1, 0, 2, 3).reshape(len(points), -1), axis=1)  # NaN last
    count = np.isfinite(near).sum(axis=1)
    quartile = near[np.arange(len(points)), np.maximum(count - 1, 0) // 4]
    some = np.isfinite(quartile)
    return np.where(some, quartile, np.median(quartile[some]) if some.any() else 0.0)


def _second_difference(points: Array, i: Indices, j: Indices, k: Indices) -> Array:
    bend = np.linalg.norm(points[i] - 2 * points[j] + points[k], axis=1)
    return np.where((i >= 0) & (k >= 0), bend, np.nan)
