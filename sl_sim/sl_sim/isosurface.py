"""The surface of a solid given by a field, by marching tetrahedra."""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import binary_dilation

from sl_sim.meshes import GREY, Mesh

Field = Callable[[np.ndarray], np.ndarray]

_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]])
_TETRAHEDRA = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]])
"""A cube's six tetrahedra about its diagonal; neighbouring cubes cut their common face alike."""


def gradient(field: Field, points: np.ndarray, step: float = 1e-5) -> np.ndarray:
    """(n, 3) central differences of a field at points (n, 3) [m]."""
    return np.stack([(field(points + step * e) - field(points - step * e)) / (2 * step) for e in np.eye(3)], -1)


def _band_values(field: Field, points: np.ndarray, counts: np.ndarray, coarse: int = 4) -> np.ndarray:
    """Field at grid points (n, 3) near the surface; +-1 elsewhere. Details below `coarse` steps away from the
    surface are lost.
    """
    ids = np.minimum(np.indices(tuple(-(-counts // coarse) + 1)).reshape(3, -1).T * coarse, counts - 1)
    strides = np.array([counts[1] * counts[2], counts[2], 1])
    shape = -(-counts // coarse) + 1
    rough = field(points[ids @ strides]).reshape(shape) > 0
    near = np.zeros_like(rough)
    for axis in range(3):
        flips = np.diff(rough.astype(np.int8), axis=axis) != 0
        low, high = [slice(None)] * 3, [slice(None)] * 3
        low[axis], high[axis] = slice(0, -1), slice(1, None)
        near[tuple(low)] |= flips
        near[tuple(high)] |= flips
    near = binary_dilation(near, np.ones((3, 3, 3)))
    fine = np.indices(tuple(counts)).reshape(3, -1) // coarse
    cell = tuple(fine)
    values = np.where(rough[cell], 1.0, -1.0)
    band = np.flatnonzero(near[cell])
    values[band] = np.concatenate([field(points[part]) for part in np.array_split(band, max(1, len(band) // 200_000))])
    return np.where(values == 0, 1e-12, values)


def mesh(
    field: Field,
    lower: tuple[float, float, float],
    upper: tuple[float, float, float],
    *,
    step: float,
    albedo: tuple[float, float, float] = GREY,
    name: str = "solid",
) -> Mesh:
    """Closed mesh of field(points (n, 3)) -> (n,) = 0, positive inside; the box lower..upper [m] must hold the solid.

    Vertices are pulled onto the surface by Newton's method, normals follow the field's gradient.
    """
    counts = np.ceil((np.asarray(upper) - lower) / step).astype(int) + 1
    axes = [low + step * np.arange(n) for low, n in zip(lower, counts, strict=True)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    values = _band_values(field, points, counts)
    strides = np.array([counts[1] * counts[2], counts[2], 1])
    first = (np.indices(tuple(counts - 1)).reshape(3, -1).T * strides).sum(1)
    corners = first[:, None] + (_CORNERS * strides).sum(1)
    inside = values[corners] > 0
    corners = corners[inside.any(1) & ~inside.all(1)]
    tetra = corners[:, _TETRAHEDRA].reshape(-1, 4)
    order = np.argsort(-values[tetra], axis=1)
    tetra = np.take_along_axis(tetra, order, axis=1)
    count = (values[tetra] > 0).sum(1)
    pieces = []
    for number, triangles in (
        (1, ([(0, 1), (0, 2), (0, 3)],)),
        (2, ([(0, 2), (0, 3), (1, 3)], [(0, 2), (1, 3), (1, 2)])),
        (3, ([(0, 3), (1, 3), (2, 3)],)),
    ):
        chosen = tetra[count == number]
        pieces += [chosen[:, np.array(triangle)] for triangle in triangles]
    edges = np.concatenate(pieces).reshape(-1, 2)  # (inside, outside) grid points, three edges a face
    keys, faces = np.unique(edges[:, 0] * len(points) + edges[:, 1], return_inverse=True)
    a, b = keys // len(points), keys % len(points)
    share = values[a] / (values[a] - values[b])
    vertices = points[a] + share[:, None] * (points[b] - points[a])
    slope = gradient(field, vertices)
    for _ in range(2):
        move = -field(vertices)[:, None] * slope / np.maximum((slope**2).sum(1, keepdims=True), 1e-12)
        vertices = vertices + np.clip(move, -0.3 * step, 0.3 * step)
    slope = gradient(field, vertices)
    normals = -slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)
    faces = faces.reshape(-1, 3)
    p, q, r = (vertices[faces[:, k]] for k in range(3))
    outward = np.einsum("ij,ij->i", np.cross(q - p, r - p), normals[faces].sum(1))
    faces = np.where(outward[:, None] < 0, faces[:, ::-1], faces)
    area = np.linalg.norm(np.cross(q - p, r - p), axis=1)
    faces = np.ascontiguousarray(faces[area > 0], np.int32)
    colour = np.tile(np.asarray(albedo, np.float32), (len(vertices), 1))
    return Mesh(vertices, faces, normals, colour, name=name)
