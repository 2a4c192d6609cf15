"""Exact truth about every projected spot in a view, by casting rays from the projector and from the camera.

A spot is the disc of light about a pattern's centre on the panel. Its true position in the image is that of its centre:
the point that the ray through the centre hits, seen by the camera. The disc's footprint, traced ray by ray, tells
how large
the spot appears, how far its centroid lies from its centre, and whether an edge of the scene cuts it.
"""

from dataclasses import dataclass

import numpy as np

from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_sim.raycast import RayCaster

RINGS = ((0.0, 1), (0.25, 6), (0.5, 12), (0.75, 18), (0.95, 24))
"""Samples of the disc: radius as a share of the disc's, number; about one per equal area."""
MARGIN = 1.35
"""An edge of the scene within this many disc radii makes the spot an edge spot."""


@dataclass(frozen=True)
class SpotTruth:
    """Arrays over the pattern's (rows, cols).

    Attributes:
        xy: (.., 2) camera px of the spot's centre, NaN where its ray hits nothing in front of the camera.
        visible: the centre is lit, in the image and seen by the camera.
        edge: a depth jump, crease, shadow, occlusion, step in the paint or the image border lies within the spot's
            margin.
        partial: the centre is not visible but part of the disc is.
        axes_px: (.., 2) minor and major diameter of the footprint. shift: (.., 2) its centroid minus xy, px.
        xyz, normal: (.., 3) base frame [m]. cos_proj, cos_cam: cosines of incidence.
        irradiance: white light's irradiance times the surface's mean reflectance at the centre.
    """

    xy: np.ndarray
    visible: np.ndarray
    edge: np.ndarray
    partial: np.ndarray
    axes_px: np.ndarray
    shift: np.ndarray
    xyz: np.ndarray
    normal: np.ndarray
    cos_proj: np.ndarray
    cos_cam: np.ndarray
    irradiance: np.ndarray


@dataclass(frozen=True)
class Lit:
    """What rays through projector pixels hit.

    Attributes:
        xyz, normal: (n, 3) base frame, NaN where nothing. body: (n,), -1 = nothing. reflectance: (n,) mean over the
            channels.
    """

    xyz: np.ndarray
    normal: np.ndarray
    body: np.ndarray
    reflectance: np.ndarray


def light_up(caster: RayCaster, projector: CameraModel, base_from_projector: np.ndarray, pixels: np.ndarray) -> Lit:
    """First hits of the projector's rays through pixels (n, 2)."""
    directions = projector.rays(pixels) @ base_from_projector[:3, :3].T
    origin = base_from_projector[:3, 3]
    hits = caster.first_hits(origin, directions)
    hit = hits.face >= 0
    face = np.maximum(hits.face, 0)
    return Lit(
        caster.points(origin, directions, hits),
        caster.normals_at(hits),
        np.where(hit, caster.face_body[face], -1),
        caster.albedo[caster.faces[face]].mean(axis=(1, 2)) * hit,
    )


def seen(
    caster: RayCaster, camera: CameraModel, base_from_camera: np.ndarray, xyz: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Camera px (n, 2) of points (n, 3), and whether each is in the image and not hidden."""
    pixels = camera.project(transforms.apply(transforms.inverse(base_from_camera), xyz))
    inside = np.isfinite(pixels).all(1) & camera.contains(np.nan_to_num(pixels, nan=-9.0))
    visible = inside.copy()
    where = np.flatnonzero(inside)
    visible[where] = ~caster.occluded(base_from_camera[:3, 3], xyz[where])
    return pixels, visible


def count_visible(
    caster: RayCaster,
    camera: CameraModel,
    base_from_camera: np.ndarray,
    projector: CameraModel,
    base_from_projector: np.ndarray,
    centers: np.ndarray,
) -> int:
    """How many spots' centres (rows, cols, 2) are lit and seen: a quick look before `spot_truth`."""
    lit = light_up(caster, projector, base_from_projector, centers.reshape(-1, 2))
    hit = lit.body >= 0
    return int(seen(caster, camera, base_from_camera, lit.xyz[hit])[1].sum())


def _disc() -> tuple[np.ndarray, np.ndarray]:
    """Offsets (n, 2) in disc radii and whether each lies in the disc (else in the margin)."""
    offsets = []
    for radius, count in (*RINGS, (0.5 * (1 + MARGIN), 16), (MARGIN, 20)):
        angle = 2 * np.pi * (np.arange(count) + 0.5 * (count % 4)) / count
        offsets.append(radius * np.stack([np.cos(angle), np.sin(angle)], -1))
    points = np.concatenate(offsets)
    return points, np.linalg.norm(points, axis=1) <= 1.0


def spot_truth(
    caster: RayCaster,
    camera: CameraModel,
    base_from_camera: np.ndarray,
    projector: CameraModel,
    base_from_projector: np.ndarray,
    centers: np.ndarray,
    diameter: float,
) -> SpotTruth:
    """Truth of the spots with centers (rows, cols, 2) [projector px] and diameter [projector px]."""
    shape = centers.shape[:2]
    offsets, in_disc = _disc()
    count, samples = shape[0] * shape[1], len(offsets)
    pixels = (centers.reshape(-1, 1, 2) + 0.5 * diameter * offsets).reshape(-1, 2)
    lit = light_up(caster, projector, base_from_projector, pixels)
    xy, visible = seen(caster, camera, base_from_camera, np.nan_to_num(lit.xyz, nan=1e6))
    xy[lit.body < 0] = np.nan
    visible &= lit.body >= 0
    towards_camera = base_from_camera[:3, 3] - lit.xyz
    towards_light = base_from_projector[:3, 3] - lit.xyz
    distance = np.linalg.norm(towards_light, axis=1)
    cos_cam = (lit.normal * towards_camera).sum(1) / np.linalg.norm(towards_camera, axis=1)
    cos_proj = (lit.normal * towards_light).sum(1) / distance
    visible &= (np.nan_to_num(cos_cam, nan=-1.0) > 0) & (np.nan_to_num(cos_proj, nan=-1.0) > 0)

    xyz, normal = lit.xyz.reshape(count, samples, 3), lit.normal.reshape(count, samples, 3)
    body, sample_xy = lit.body.reshape(count, samples), xy.reshape(count, samples, 2)
    sample_visible = visible.reshape(count, samples)
    centre_visible = sample_visible[:, 0]
    edge = _cut(xyz, normal, body, sample_visible)
    border = np.nan_to_num(sample_xy, nan=-99.0)
    paint = lit.reflectance.reshape(count, samples)
    edge |= paint.max(1) > 1.6 * np.maximum(paint.min(1), 1e-6)
    size = np.array([camera.width - 1, camera.height - 1])
    edge |= ((border < 1.0) | (border > size - 1.0)).any(axis=(1, 2))

    weight = (sample_visible & in_disc).astype(float)
    weight *= np.nan_to_num(np.maximum(cos_proj, 0.0).reshape(count, samples)) * paint + 1e-9
    total = np.maximum(weight.sum(1), 1e-12)
    known = np.nan_to_num(sample_xy)
    centroid = (weight[..., None] * known).sum(1) / total[:, None]
    axes = _axes(known, in_disc & (body >= 0))
    cosine = lambda a: np.nan_to_num(a.reshape(count, samples)[:, 0], nan=-1.0).reshape(shape)  # noqa: E731
    cos_theta = 1.0 / np.linalg.norm(projector.rays(centers.reshape(-1, 2)), axis=1)
    centre_distance = distance.reshape(count, samples)[:, 0]
    irradiance = np.maximum(cosine(cos_proj).ravel(), 0) / (cos_theta**3 * centre_distance**2) * paint[:, 0]
    return SpotTruth(
        xy=sample_xy[:, 0].reshape(*shape, 2),
        visible=centre_visible.reshape(shape),
        edge=edge.reshape(shape),
        partial=((sample_visible & in_disc).any(1) & ~centre_visible).reshape(shape),
        axes_px=axes.reshape(*shape, 2),
        shift=np.where(weight.sum(1, keepdims=True) > 1e-6, centroid - sample_xy[:, 0], np.nan).reshape(*shape, 2),
        xyz=xyz[:, 0].reshape(*shape, 3),
        normal=normal[:, 0].reshape(*shape, 3),
        cos_proj=cosine(cos_proj),
        cos_cam=cosine(cos_cam),
        irradiance=np.nan_to_num(irradiance).reshape(shape),
    )


def _cut(xyz: np.ndarray, normal: np.ndarray, body: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """(n,) bool: the samples (n, k) of a disc differ in body or visibility, or do not lie on one smooth surface."""
    cut = (body != body[:, :1]).any(1) | (visible != visible[:, :1]).any(1) | (body[:, 0] < 0)
    apart = np.nan_to_num(xyz - xyz[:, :1])
    reach = np.linalg.norm(apart, axis=-1)
    off_plane = np.abs((apart * np.nan_to_num(normal[:, :1])).sum(-1))
    alike = (np.nan_to_num(normal) * np.nan_to_num(normal[:, :1])).sum(-1)
    return cut | (off_plane > 0.25 * np.maximum(reach, 1e-9)).any(1) | (alike < 0.7).any(1)


def _axes(xy: np.ndarray, use: np.ndarray) -> np.ndarray:
    """(n, 2) minor and major diameter [px] of ellipses with the second moments of samples xy (n, k, 2)."""
    weight = use.astype(float)
    total = np.maximum(weight.sum(1), 1.0)
    mean = (weight[..., None] * xy).sum(1) / total[:, None]
    off = (xy - mean[:, None]) * weight[..., None]
    moment = np.einsum("nki,nkj->nij", off, off) / total[:, None, None]
    # the rings sample the disc with a mean square radius that differs slightly from the uniform disc's half
    rings = np.array([radius for radius, count in RINGS for _ in range(count)])
    return 4.0 * np.sqrt(np.maximum(np.linalg.eigvalsh(moment), 0.0) * 0.5 / (rings**2).mean())
