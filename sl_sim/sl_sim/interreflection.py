"""One bounce of the projector's light from surface to surface.

The panel is cut into a coarse grid of cells. What each cell's beam hits is a small Lambertian source (a virtual point
light); receivers are nodes of the camera's lattice on a coarse grid, filled up between with regard to edges. Visibility
between sources and receivers is traced once per view; after that, other light costs one matrix product.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from sl_common.cameras import CameraModel
from sl_sim.raycast import RayCaster

CELLS = (24, 18)
"""Sources across and down the panel."""
SPACING = 10
"""Distance of the receivers [px]."""


@dataclass(frozen=True)
class Transfer:
    """What the bounce needs of one view.

    Attributes:
        albedo_flux: (sources, 3) float32 diffuse reflectance times the flux of a white cell.
        matrix: (receivers, sources) float32 irradiance at a receiver per unit of a source's reflected flux.
        points, normals: (rows, cols, 3) float32 receivers; body: (rows, cols) int32, -1 = no surface.
    """

    albedo_flux: np.ndarray
    matrix: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    body: np.ndarray


def transfer(
    caster: RayCaster,
    projector: CameraModel,
    base_from_projector: np.ndarray,
    vignetting: float,
    points: np.ndarray,
    normals: np.ndarray,
    body: np.ndarray,
    step: int,
) -> Transfer:
    """Trace sources, receivers and what lies between; points, normals (h, w, 3), body (h, w): the camera's node
    lattice; step: nodes
    between receivers.
    """
    across, down = CELLS
    cell = np.array([projector.width / across, projector.height / down])
    u, v = np.meshgrid((np.arange(across) + 0.5) * cell[0] - 0.5, (np.arange(down) + 0.5) * cell[1] - 0.5)
    rays = projector.rays(np.stack([u, v], -1).reshape(-1, 2))
    origin, directions = base_from_projector[:3, 3], rays @ base_from_projector[:3, :3].T
    hits = caster.first_hits(origin, directions)
    source = np.nan_to_num(caster.points(origin, directions, hits))
    source_normal = np.nan_to_num(caster.normals_at(hits))
    focal = projector.matrix[0, 0] * projector.matrix[1, 1]
    radius2 = (rays[:, :2] ** 2).sum(1)
    flux = cell.prod() / focal * (1.0 - vignetting * radius2 / radius2.max()) * (hits.face >= 0)
    albedo = caster.albedo[caster.faces[np.maximum(hits.face, 0), 0]]
    spread2 = cell.prod() / focal * (source - origin)[:, None, :] @ (source - origin)[:, :, None] / np.pi

    at = points[::step, ::step], normals[::step, ::step], body[::step, ::step]
    receiver, receiver_normal = at[0].reshape(-1, 3).astype(float), at[1].reshape(-1, 3).astype(float)
    between = receiver[:, None, :] - source[None]
    distance2 = (between**2).sum(-1)
    unit = between / np.sqrt(np.maximum(distance2, 1e-12))[..., None]
    leaving = np.einsum("rsk,sk->rs", unit, source_normal)
    arriving = -np.einsum("rsk,rk->rs", unit, receiver_normal)
    matrix = np.where((leaving > 0) & (arriving > 0), leaving * arriving, 0.0) / (np.pi * (distance2 + spread2.ravel()))
    matrix[at[2].ravel() < 0] = 0.0
    rows, cols = np.nonzero(matrix * flux > 1e-3 * max(float((matrix * flux).max()), 1e-12))
    offset = source[cols] + 1e-3 * source_normal[cols]
    blocked = caster.occluded(offset, receiver[rows] + 1e-3 * receiver_normal[rows], slack=1e-3)
    matrix[rows[blocked], cols[blocked]] = 0.0
    return Transfer(
        (albedo * flux[:, None]).astype(np.float32), matrix.astype(np.float32), *(np.ascontiguousarray(a) for a in at)
    )


def irradiance(light: np.ndarray, moved: Transfer) -> np.ndarray:
    """(rows, cols, 3) float32 bounced irradiance at the receivers under a projector light image (H, W, 3)."""
    mean = cv2.resize(light, CELLS, interpolation=cv2.INTER_AREA).reshape(-1, 3)
    return (moved.matrix @ (moved.albedo_flux * mean)).reshape(*moved.body.shape, 3)


@njit(cache=True)
def fill_up(
    coarse: np.ndarray,
    coarse_points: np.ndarray,
    coarse_normals: np.ndarray,
    coarse_body: np.ndarray,
    step: int,
    rows: np.ndarray,
    cols: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    albedo: np.ndarray,
    body: np.ndarray,
    out: np.ndarray,
) -> None:
    """Add albedo times the irradiance interpolated from receivers of the same surface to out (n, 3), at lattice
    rows, cols (n,).
    """
    height, width = coarse_body.shape
    for i in range(rows.shape[0]):
        if body[i] < 0:
            continue
        y, x = rows[i] / step, cols[i] / step
        i0, j0 = min(int(y), max(height - 2, 0)), min(int(x), max(width - 2, 0))
        fy, fx = min(y - i0, 1.0), min(x - j0, 1.0)
        total, red, green, blue = 0.0, 0.0, 0.0, 0.0
        for k in range(4):
            ii, jj = min(i0 + (k >> 1), height - 1), min(j0 + (k & 1), width - 1)
            if coarse_body[ii, jj] < 0:
                continue
            alike, away, apart = 0.0, 0.0, 0.0
            for a in range(3):
                d = points[i, a] - coarse_points[ii, jj, a]
                alike += normals[i, a] * coarse_normals[ii, jj, a]
                away += d * normals[i, a]
                apart += d * d
            weight = ((fy if k >> 1 else 1.0 - fy) * (fx if k & 1 else 1.0 - fx) + 1e-3) * max(alike, 0.0) ** 8
            weight *= 1e-3 + 1.0 / (1.0 + 50.0 * away * away / (apart + 1e-8))
            total += weight
            red += weight * coarse[ii, jj, 0]
            green += weight * coarse[ii, jj, 1]
            blue += weight * coarse[ii, jj, 2]
        if total > 1e-6:
            out[i, 0] += albedo[i, 0] * red / total
            out[i, 1] += albedo[i, 1] * green / total
            out[i, 2] += albedo[i, 2] * blue / total
