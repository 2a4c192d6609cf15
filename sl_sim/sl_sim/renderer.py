"""Images of a scene in a projector's light, as a camera sees it.

Each pixel is integrated over samples x samples sub-pixels. Rays are traced through a lattice of nodes; where the
surface between four nodes is smooth, evenly lit and of one body, the sub-pixels' projector coordinates and light
transport follow by interpolation, elsewhere (edges, shadows, creases) each sub-pixel gets rays of its own. Where
neither camera, projector nor scene has moved, all of this is kept and only the light is gathered again.
"""

from dataclasses import dataclass

import numpy as np

from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_sim import interreflection, kernels
from sl_sim.light import LightSource, Occluders
from sl_sim.projector import LIGHT_SCALE
from sl_sim.raycast import RayCaster
from sl_sim.render_options import RenderOptions


@dataclass
class _Shaded:
    points: np.ndarray
    normals: np.ndarray
    uv: np.ndarray
    gain: np.ndarray
    sky: np.ndarray
    albedo: np.ndarray
    body: np.ndarray
    flags: np.ndarray

    @classmethod
    def empty(cls, n: int) -> "_Shaded":
        three = [np.zeros((n, 3), np.float32) for _ in range(5)]
        uv = np.zeros((n, 2), np.float32)
        return cls(three[0], three[1], uv, three[2], three[3], three[4], np.zeros(n, np.int32), np.zeros(n, np.uint8))


@dataclass
class _View:
    """What is kept while nothing moves."""

    nodes: _Shaded
    slot_of_cell: np.ndarray
    fine: _Shaded
    transfer: interreflection.Transfer | None = None


class Renderer:
    """Renders radiance images; keeps the geometry of the last view.

    Args:
        caster: the scene. camera: intrinsics. light: the projector. options: see RenderOptions.
    """

    def __init__(self, caster: RayCaster, camera: CameraModel, light: LightSource, options: RenderOptions) -> None:
        self.caster, self.camera, self.light, self.options = caster, camera, light, options
        width, height, samples = camera.width, camera.height, options.samples
        step = options.lattice
        self._shape = (-(-(height + 1) // step) + 1, -(-(width + 1) // step) + 1)
        u, v = np.meshgrid(-1.0 + step * np.arange(self._shape[1]), -1.0 + step * np.arange(self._shape[0]))
        rays = camera.rays(np.stack([u, v], -1).reshape(-1, 2))
        self._node_rays = np.where(np.isfinite(rays), rays, [0.0, 0.0, -1.0]).astype(np.float32)
        self._node_buffers = _Shaded.empty(len(self._node_rays))
        k = ((np.arange(max(width, height) * samples) + 0.5) / samples + 0.5) / step
        self._cell = np.floor(k).astype(np.int32)
        self._fraction = (k - self._cell).astype(np.float32)
        across = step * samples  # sub-pixels across a cell
        self._parts = np.sort(self._fraction[:across])
        self._part = np.round((self._fraction - self._parts[0]) * across).astype(np.int32)
        self._receiver_step = max(1, interreflection.SPACING // step)
        self._key: tuple | None = None
        self._view: _View | None = None

    def radiance(
        self,
        light: np.ndarray,
        base_from_camera: np.ndarray,
        *,
        occluders: Occluders | None = None,
        lens_point: tuple[float, float] = (0.0, 0.0),
        focus: float = 0.0,
    ) -> np.ndarray:
        """Radiance (H, W, 3) float32 RGB, pi folded in: a white facing surface at 1 m under white light has 1.

        Args:
            light: the projector's light image (projector.light_image).
            base_from_camera: (4, 4) pose of the optical frame.
            occluders: the arm's capsules, if it may stand in the light.
            lens_point: point of the entrance pupil (x, y) [m] that the rays pass, for defocus.
            focus: distance [m] of the sharp plane; 0 = everything sharp (lens_point is ignored).
        """
        occluders = occluders or Occluders()
        key = (
            base_from_camera.tobytes(),
            self.light.base_from_projector.tobytes(),
            self.caster.version,
            occluders.ends.tobytes(),
            lens_point,
            focus,
        )
        if key != self._key or self._view is None:
            self._view = self._trace(base_from_camera, occluders, lens_point, focus)
            self._key = key
        view = self._view
        sky, fine_sky = self._with_bounce(light, view)
        image = np.empty((self.camera.height, self.camera.width, 3), np.float32)
        kernels.gather(
            light, float(LIGHT_SCALE), view.nodes.uv, view.nodes.gain, sky, view.slot_of_cell,
            view.fine.uv, view.fine.gain, fine_sky, self._cell, self._fraction, self._part, self.options.samples,
            len(self._parts), image,
        )  # fmt: skip
        return image

    def _with_bounce(self, light: np.ndarray, view: _View) -> tuple[np.ndarray, np.ndarray]:
        """Radiance besides the direct light, of the nodes and of the fine samples."""
        if view.transfer is None:
            return view.nodes.sky, view.fine.sky
        coarse = interreflection.irradiance(light, view.transfer)
        node_rows, node_cols = np.indices(view.nodes.body.shape, np.float32)
        cells = np.argwhere(view.slot_of_cell >= 0).astype(np.float32)
        fine_rows, fine_cols = (np.repeat(cells[:, k, None] + 0.5, view.fine.body.shape[1], 1) for k in (0, 1))
        result = []
        for part, rows, cols in ((view.nodes, node_rows, node_cols), (view.fine, fine_rows, fine_cols)):
            sky = part.sky.copy()
            interreflection.fill_up(
                coarse, view.transfer.points, view.transfer.normals, view.transfer.body, self._receiver_step,
                rows.ravel(),
                cols.ravel(), part.points.reshape(-1, 3), part.normals.reshape(-1, 3), part.albedo.reshape(-1, 3),
                part.body.ravel(), sky.reshape(-1, 3),
            )  # fmt: skip
            result.append(sky)
        return result[0], result[1]

    def _trace(
        self, base_from_camera: np.ndarray, occluders: Occluders, lens_point: tuple[float, float], focus: float
    ) -> _View:
        shape, step = self._shape, self.options.lattice
        nodes = self._shade(self._node_rays, base_from_camera, occluders, lens_point, focus, self._node_buffers)
        nodes = _Shaded(*(a.reshape(*shape, *a.shape[1:]) for a in vars(nodes).values()))
        uneven = np.empty((shape[0] - 1, shape[1] - 1), np.uint8)
        kernels.uneven_cells(nodes.points, nodes.normals, nodes.albedo, nodes.body, nodes.flags, uneven)
        slot_of_cell = np.full(uneven.shape, -1, np.int32)
        rows, cols = np.nonzero(uneven)
        slot_of_cell[rows, cols] = np.arange(len(rows), dtype=np.int32)
        dv, du = np.meshgrid(self._parts, self._parts, indexing="ij")
        pixels = step * np.stack([cols[:, None] + du.ravel(), rows[:, None] + dv.ravel()], -1) - 1.0
        rays = self.camera.rays(pixels.reshape(-1, 2))
        fine = self._shade(rays, base_from_camera, occluders, lens_point, focus, _Shaded.empty(len(rays)))
        fine = _Shaded(*(a.reshape(len(rows), len(self._parts) ** 2, *a.shape[1:]) for a in vars(fine).values()))
        moved = None
        if self.options.interreflection:
            moved = interreflection.transfer(
                self.caster, self.light.model, self.light.base_from_projector, self.options.projector_vignetting,
                nodes.points, nodes.normals, nodes.body, self._receiver_step,
            )  # fmt: skip
        return _View(nodes, slot_of_cell, fine, moved)

    def _shade(
        self,
        rays: np.ndarray,
        base_from_camera: np.ndarray,
        occluders: Occluders,
        lens_point: tuple[float, float],
        focus: float,
        out: _Shaded,
    ) -> _Shaded:
        offset = np.array([*lens_point, 0.0]) if focus > 0 else np.zeros(3)
        if focus > 0:
            rays = rays - (offset / focus).astype(rays.dtype)
        origin = base_from_camera[:3, :3] @ offset + base_from_camera[:3, 3]
        directions = (rays @ base_from_camera[:3, :3].T.astype(rays.dtype)).astype(np.float32, copy=False)
        hits = self.caster.first_hits(origin, directions)
        model, caster = self.light.model, self.caster
        source = np.ascontiguousarray(self.light.base_from_projector[:3, 3])
        k = np.array([model.matrix[0, 0], model.matrix[1, 1], model.matrix[0, 2], model.matrix[1, 2]])
        distorted = model.distortion_model != "none"
        kernels.shade_points(
            origin, directions, hits.distance, hits.face, hits.u, hits.v, caster.faces, caster.normals, caster.albedo,
            caster.face_body, caster.gloss, transforms.inverse(self.light.base_from_projector), source, k,
            np.array([float(model.width), float(model.height)]), distorted, self.options.projector_vignetting,
            self.options.ambient, np.array([0.0, 0.0, 1.0]), out.points, out.normals, out.uv, out.gain, out.sky,
            out.albedo, out.body, out.flags,
        )  # fmt: skip
        if distorted:
            out.uv[:] = model.to_pixels(model.distort(out.uv.astype(np.float64)))
        out.sky *= np.asarray(self.options.ambient_colour, np.float32)
        lit = np.flatnonzero(out.flags & kernels.LIT)
        dark = self.caster.occluded(source, out.points[lit])
        if len(occluders.radii):
            blocked = np.zeros(len(directions), np.bool_)
            kernels.capsules_between(source, out.points, out.flags, occluders.ends, occluders.radii, blocked)
            dark |= blocked[lit]
        dark = lit[dark]
        out.gain[dark] = 0.0
        out.flags[dark] = kernels.HIT
        return out
