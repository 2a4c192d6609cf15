"""Triangle meshes with per-vertex normals and reflectance, and the solids that scenes are made of."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sl_common import transforms

GREY = (0.75, 0.75, 0.75)


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh in its body's frame [m].

    Attributes:
        vertices: (n, 3) float64.
        faces: (m, 3) int32, counter-clockwise seen from outside.
        normals: (n, 3) float64 unit shading normals; vertices on a crease are repeated, one per face.
        albedo: (n, 3) float32 linear RGB diffuse reflectance in [0, 1].
        gloss: share of light reflected by the glossy lobe, 0 = matt.
        gloss_exponent: Blinn exponent of the lobe; higher = sharper highlight.
        name: for reports and the truth.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    albedo: np.ndarray
    gloss: float = 0.0
    gloss_exponent: float = 40.0
    name: str = "body"

    def moved(self, parent_from_body: np.ndarray) -> "Mesh":
        """The same mesh expressed in the parent frame."""
        return replace(
            self,
            vertices=transforms.apply(parent_from_body, self.vertices),
            normals=self.normals @ parent_from_body[:3, :3].T,
        )

    def painted(self, colour: Callable[[np.ndarray], np.ndarray]) -> "Mesh":
        """The same mesh with albedo colour(vertices (n, 3)) -> (n, 3), clipped to [0.02, 0.95]."""
        albedo = np.clip(colour(self.vertices), 0.02, 0.95).astype(np.float32)
        return replace(self, albedo=np.ascontiguousarray(np.broadcast_to(albedo, self.vertices.shape)))


def smooth_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(n, 3) unit normals: the mean of the adjacent faces' normals weighted by their area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    face_normals = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for k in range(3):
        for axis in range(3):
            normals[:, axis] += np.bincount(faces[:, k], face_normals[:, axis], minlength=len(vertices))
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def _lattice_faces(rows: int, cols: int) -> np.ndarray:
    """Faces of a lattice of rows x cols vertices; counter-clockwise for x along cols, y along rows, seen from +z."""
    index = np.arange(rows * cols).reshape(rows, cols)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([a, d, c], -1).reshape(-1, 3)])
    return faces.astype(np.int32)


def _mesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    albedo: tuple[float, float, float],
    name: str,
    normals: np.ndarray | None = None,
) -> Mesh:
    if normals is None:
        normals = smooth_normals(vertices, faces)
    return Mesh(vertices, faces, normals, np.tile(np.asarray(albedo, np.float32), (len(vertices), 1)), name=name)


def height_field(
    height: Callable[[np.ndarray, np.ndarray], np.ndarray],
    width: float,
    depth: float,
    *,
    step: float = 0.003,
    albedo: tuple[float, float, float] = GREY,
    name: str = "height field",
) -> Mesh:
    """The surface z = height(x, y) over a width x depth rectangle centred on the origin, facing +z; step: lattice
    [m].
    """
    cols, rows = max(2, round(width / step) + 1), max(2, round(depth / step) + 1)
    x, y = np.meshgrid(np.linspace(-width / 2, width / 2, cols), np.linspace(-depth / 2, depth / 2, rows))
    z = np.broadcast_to(height(x, y), x.shape)
    return _mesh(np.stack([x, y, z], -1).reshape(-1, 3), _lattice_faces(rows, cols), albedo, name)


def rectangle(width: float, depth: float, *, albedo: tuple[float, float, float] = GREY, name: str = "plane") -> Mesh:
    """A flat rectangle at z = 0 facing +z, as two triangles."""
    return height_field(lambda x, y: 0 * x, width, depth, step=max(width, depth), albedo=albedo, name=name)


def star_shape(
    radius: Callable[[np.ndarray], np.ndarray],
    *,
    parallels: int = 240,
    albedo: tuple[float, float, float] = GREY,
    name: str = "star shape",
) -> Mesh:
    """The closed surface at distance radius(unit directions (n, 3)) -> (n,) from the origin; the poles lie on +-y."""
    polar, azimuth = np.meshgrid(
        np.linspace(0, np.pi, parallels), np.linspace(0, 2 * np.pi, 2 * parallels), indexing="ij"
    )
    direction = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], -1)
    shape = polar.shape
    vertices = (radius(direction.reshape(-1, 3))[:, None] * direction.reshape(-1, 3)).reshape(*shape, 3)
    vertices[:, -1] = vertices[:, 0]
    vertices[0], vertices[-1] = vertices[0].mean(0), vertices[-1].mean(0)
    flat, faces = vertices.reshape(-1, 3), _lattice_faces(*shape)[:, ::-1].copy()
    normals = smooth_normals(flat, faces).reshape(*shape, 3)
    for line in (0, -1):  # the seam and the poles are one vertex stored several times
        normals[line] = normals[line].mean(0)
    normals[:, 0] = normals[:, -1] = normals[:, 0] + normals[:, -1]
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-30)
    return _mesh(flat, np.ascontiguousarray(faces, np.int32), albedo, name, normals.reshape(-1, 3))


def sphere(
    radius: float, *, parallels: int = 240, albedo: tuple[float, float, float] = GREY, name: str = "sphere"
) -> Mesh:
    """A sphere about the origin, tessellated so finely that its facets deviate by radius * 2e-5 at the default."""
    mesh = star_shape(lambda d: np.full(len(d), radius), parallels=parallels, albedo=albedo, name=name)
    return replace(mesh, normals=mesh.vertices / radius)


def cylinder(
    radius: float, length: float, *, sides: int = 360, albedo: tuple[float, float, float] = GREY, name: str = "cylinder"
) -> Mesh:
    """A cylinder about the y axis with flat caps."""
    angle = np.linspace(0, 2 * np.pi, sides + 1)
    ring = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1)
    down, up = radius * ring - [0, length / 2, 0], radius * ring + [0, length / 2, 0]
    side = _mesh(np.concatenate([down, up]), _lattice_faces(2, sides + 1), albedo, name, np.tile(ring, (2, 1)))
    fan = np.stack([np.arange(sides), np.arange(1, sides + 1), np.full(sides, sides + 1)], -1).astype(np.int32)
    parts = [side]
    for edge, sign in ((up, 1.0), (down, -1.0)):
        centre = np.array([[0.0, sign * length / 2, 0.0]])
        normal = np.tile([0.0, sign, 0.0], (sides + 2, 1))
        parts.append(
            _mesh(np.concatenate([edge, centre]), fan if sign > 0 else fan[:, [1, 0, 2]], albedo, name, normal)
        )
    return join(parts, name)


def box(size: tuple[float, float, float], *, albedo: tuple[float, float, float] = GREY, name: str = "box") -> Mesh:
    """A box about the origin with sharp edges; size along x, y, z."""
    half = np.asarray(size, float) / 2
    parts = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            normal = sign * np.eye(3)[axis]
            corners = np.array([normal + s * u + t * v for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]) * half
            order = [[0, 1, 2], [0, 2, 3]] if sign > 0 else [[0, 2, 1], [0, 3, 2]]
            parts.append(_mesh(corners, np.array(order, np.int32), albedo, name, np.tile(normal, (4, 1))))
    return join(parts, name)


def join(parts: list[Mesh], name: str) -> Mesh:
    """One mesh of several; gloss is the first part's."""
    offsets = np.cumsum([0] + [len(p.vertices) for p in parts[:-1]])
    return replace(
        parts[0],
        vertices=np.concatenate([p.vertices for p in parts]),
        faces=np.concatenate([p.faces + np.int32(k) for p, k in zip(parts, offsets, strict=True)]).astype(np.int32),
        normals=np.concatenate([p.normals for p in parts]),
        albedo=np.concatenate([p.albedo for p in parts]),
        name=name,
    )
