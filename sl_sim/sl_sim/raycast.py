"""First hits and occlusion of rays against a scene, by Embree."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from sl_common import transforms
from sl_sim.meshes import Mesh


@dataclass(frozen=True)
class Body:
    """A mesh that moves as one; base_from_body places it. Bodies with moving=False share one acceleration structure."""

    mesh: Mesh
    base_from_body: np.ndarray
    moving: bool = False


@dataclass(frozen=True)
class Hits:
    """First hits of n rays: distance in units of the direction's length (inf = none), global face index (-1 = none),
    barycentrics.
    """

    distance: np.ndarray
    face: np.ndarray
    u: np.ndarray
    v: np.ndarray


class RayCaster:
    """The scene's acceleration structures and its surface attributes, in the base frame.

    Attributes:
        faces: (m, 3) int32 global vertex indices; normals: (n, 3) float32, base frame; albedo: (n, 3) float32;
        face_body: (m,) int32 index into `bodies`; gloss: (bodies, 2) float32 share and exponent.
        version: grows whenever a body has moved.
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        self.version = 0
        fixed = [i for i, body in enumerate(bodies) if not body.moving]
        groups = ([fixed] if fixed else []) + [[i] for i, body in enumerate(bodies) if body.moving]
        self.bodies = [bodies[i] for group in groups for i in group]
        self._scenes: list[EmbreeScene] = []
        self._base_from_group: list[np.ndarray] = []
        self._first_face: list[int] = []
        self._vertex_slice: list[slice] = []
        faces, normals, albedo, face_body = [], [], [], []
        vertex_count = face_count = body_count = 0
        for group in groups:
            moving = bodies[group[0]].moving
            vertices_of_group, faces_of_group, local = [], [], 0
            first_vertex = vertex_count
            self._first_face.append(face_count)
            for i in group:
                mesh = bodies[i].mesh if moving else bodies[i].mesh.moved(bodies[i].base_from_body)
                vertices_of_group.append(mesh.vertices)
                faces_of_group.append(mesh.faces + local)
                faces.append(mesh.faces + vertex_count)
                normals.append(mesh.normals)
                albedo.append(mesh.albedo)
                face_body.append(np.full(len(mesh.faces), body_count, np.int32))
                local += len(mesh.vertices)
                vertex_count += len(mesh.vertices)
                face_count += len(mesh.faces)
                body_count += 1
            scene = EmbreeScene(robust=True)
            TriangleMesh(
                scene,
                np.ascontiguousarray(np.concatenate(vertices_of_group), np.float32),
                np.ascontiguousarray(np.concatenate(faces_of_group), np.int32),
            )
            self._scenes.append(scene)
            self._base_from_group.append(bodies[group[0]].base_from_body if moving else np.eye(4))
            self._vertex_slice.append(slice(first_vertex, vertex_count))
        self.faces = np.concatenate(faces).astype(np.int32)
        self._body_normals = np.concatenate(normals)
        self.normals = self._body_normals.astype(np.float32)
        self.albedo = np.ascontiguousarray(np.concatenate(albedo), np.float32)
        self.face_body = np.concatenate(face_body)
        self.gloss = np.array([[b.mesh.gloss, b.mesh.gloss_exponent] for b in self.bodies], np.float32)
        for index, pose in enumerate(self._base_from_group):
            self._rotate_normals(index, pose)

    def _rotate_normals(self, group: int, pose: np.ndarray) -> None:
        part = self._vertex_slice[group]
        self.normals[part] = self._body_normals[part] @ pose[:3, :3].T

    def move(self, body: int, base_from_body: np.ndarray) -> None:
        """Put the moving body with this index (in `bodies`) at another pose."""
        if not self.bodies[body].moving:
            raise ValueError(f"body {body} ({self.bodies[body].mesh.name}) is fixed")
        fixed = sum(not b.moving for b in self.bodies)
        group = body - fixed + (1 if fixed else 0)
        if not np.array_equal(self._base_from_group[group], base_from_body):
            self._base_from_group[group] = np.array(base_from_body, float)
            self._rotate_normals(group, base_from_body)
            self.version += 1

    def first_hits(self, origins: np.ndarray, directions: np.ndarray) -> Hits:
        """First hits of rays in the base frame. origins (3,) or (n, 3), directions (n, 3), any length."""
        best: Hits | None = None
        for group, scene in enumerate(self._scenes):
            o, d = self._to_group(group, origins, directions)
            found = scene.run(o, d, output=1)
            distance, face = found["tfar"], found["primID"]
            missed = face < 0
            distance[missed] = np.inf
            face += np.int32(self._first_face[group])
            face[missed] = -1
            if best is None:
                best = Hits(distance, face, found["u"], found["v"])
            else:
                nearer = distance < best.distance
                for old, new in zip(
                    (best.distance, best.face, best.u, best.v), (distance, face, found["u"], found["v"]), strict=True
                ):
                    old[nearer] = new[nearer]
        if best is None:
            raise ValueError("the scene has no body")
        return best

    def occluded(self, origin: np.ndarray, points: np.ndarray, *, slack: float = 3e-4) -> np.ndarray:
        """(n,) bool: something lies between origin (3,) or (n, 3) and the points (n, 3), further than slack [m]
        before them.
        """
        towards = points - origin
        length = np.sqrt(np.einsum("ij,ij->i", towards, towards))
        reach = np.maximum(1.0 - slack / np.maximum(length, 1e-9), 0.0).astype(np.float32)
        blocked = np.zeros(len(points), bool)
        for group, scene in enumerate(self._scenes):
            o, d = self._to_group(group, origin, towards)
            blocked |= scene.run(o, d, dists=reach.copy(), query="OCCLUDED") >= 0
        return blocked

    def _to_group(self, group: int, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pose = self._base_from_group[group]
        if np.array_equal(pose, np.eye(4)):
            o, d = origins, directions
        else:
            o, d = transforms.apply(transforms.inverse(pose), np.atleast_2d(origins)), directions @ pose[:3, :3]
        o = np.ascontiguousarray(np.broadcast_to(np.asarray(o, np.float32), directions.shape))
        return o, np.ascontiguousarray(d, np.float32)

    def points(self, origins: np.ndarray, directions: np.ndarray, hits: Hits) -> np.ndarray:
        """(n, 3) hit points [m], float64, base frame; NaN where there is no hit."""
        distance = np.where(hits.face >= 0, hits.distance, np.nan).astype(np.float64)
        return origins + distance[:, None] * directions

    def normals_at(self, hits: Hits) -> np.ndarray:
        """(n, 3) unit shading normals at hits, base frame; NaN where there is no hit."""
        corner = self.faces[np.maximum(hits.face, 0)]
        w = 1.0 - hits.u - hits.v
        normal = (
            w[:, None] * self.normals[corner[:, 0]]
            + hits.u[:, None] * self.normals[corner[:, 1]]
            + hits.v[:, None] * self.normals[corner[:, 2]]
        ).astype(np.float64)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        normal[hits.face < 0] = np.nan
        return normal
