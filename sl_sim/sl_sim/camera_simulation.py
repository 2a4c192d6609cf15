"""The cell's camera: takes exposures of the scene as the projector lights it."""

import numpy as np

from sl_common import transforms
from sl_sim import sensor
from sl_sim.arm import ArmBody
from sl_sim.cell import Cell
from sl_sim.effects import Effects
from sl_sim.errors import CellError
from sl_sim.exposures import Exposure, Taken
from sl_sim.projector import light_image
from sl_sim.renderer import Renderer
from sl_sim.warmup import warm_up


class CameraSimulation:
    """Takes exposures of a cell; keeps the state of the automatic exposure between them.

    Args:
        cell: the cell. effects: light, projector and sensor. self_shadow: the arm may stand in the projector's light.
    """

    def __init__(self, cell: Cell, effects: Effects, *, self_shadow: bool = True) -> None:
        self._cell, self._effects = cell, effects
        self._renderer = Renderer(cell.caster, cell.camera, cell.light_source, effects.render_options)
        self._falloff = sensor.lens_falloff(cell.camera, effects.sensor.vignetting)
        self._body = ArmBody(cell.flange_from_camera) if self_shadow else None
        self._rng = np.random.default_rng([cell.settings.seed, 17])
        self._gain = 0.0
        warm_up()
        self.show(np.zeros((cell.projector.height, cell.projector.width, 3), np.uint8))

    def show(self, projector_bgr: np.ndarray) -> None:
        """What the projector shows from now on, (H, W, 3) uint8 BGR of the projector's size."""
        expected = (self._cell.projector.height, self._cell.projector.width, 3)
        if projector_bgr.shape != expected:
            raise CellError(f"projector image of shape {projector_bgr.shape}, expected {expected}")
        self._light = light_image(projector_bgr, self._effects.projector)

    def take(self, exposure: Exposure) -> Taken:
        """Render one exposure."""
        if exposure.projector_bgr is not None:
            self.show(exposure.projector_bgr)
        self._cell.place_object(exposure.base_from_object if self._cell.settings.moves else None)
        positions = exposure.positions[self._instants(exposure.positions)]
        total: np.ndarray | None = None
        for q in positions:
            occluders = self._body.at(q) if self._body else None
            image = self._renderer.radiance(self._light, self._cell.base_from_camera(q), occluders=occluders)
            total = image if total is None else total + image
        assert total is not None
        signal_ = sensor.filtered(total / np.float32(len(positions)), self._falloff, self._effects.sensor)
        self._adapt(signal_)
        image = sensor.expose(signal_, self._gain, self._effects.sensor, self._rng)
        middle = exposure.positions[len(exposure.positions) // 2]
        return Taken(exposure.stamp, image, self._cell.base_from_camera(middle), exposure.base_from_object, self._gain)

    def _instants(self, positions: np.ndarray) -> list[int]:
        """As many of the instants (symmetric about the middle) as the image's motion [px] asks for."""
        middle = len(positions) // 2
        first, last = (self._cell.base_from_camera(positions[k]) for k in (0, -1))
        depth = np.linalg.norm(self._cell.base_from_object[:3, 3] - first[:3, 3])
        move = np.linalg.norm(transforms.difference(first, last)[:3]) / depth + transforms.rotation_angle(
            first[:3, :3].T @ last[:3, :3]
        )
        if move * self._cell.camera.matrix[0, 0] < 0.3:
            return [middle]
        return list(range(len(positions)))

    def _adapt(self, signal_: np.ndarray) -> None:
        options = self._effects.sensor
        if options.exposure > 0:
            self._gain = options.exposure
            return
        wanted = sensor.automatic_exposure(signal_, options)
        if self._gain == 0:
            self._gain = wanted
        elif not 0.93 < wanted / self._gain < 1.07:  # hold still for small changes, as cameras do
            self._gain *= float(np.clip(wanted / self._gain, 0.25, 4.0))
