"""The cell's camera in a process of its own, so that rendering never delays the arm.

The worker builds the same cell from the same settings and renders one exposure at a time; the parent asks, goes on, and polls.
"""

import multiprocessing
import signal
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from sl_common import transforms
from sl_common.errors import StructuredLightError
from sl_sim import sensor
from sl_sim.arm import ArmBody
from sl_sim.cell import Cell, CellSettings
from sl_sim.effects import Effects
from sl_sim.projector import light_image
from sl_sim.renderer import Renderer


class WorkerError(StructuredLightError):
    """The rendering process has failed."""


@dataclass(frozen=True)
class Exposure:
    """One image to take.

    Attributes:
        stamp: [ns], the middle of the exposure. positions: (k, 6) true joints at k instants spread evenly over the exposure.
        base_from_object: the object's pose at the stamp.
        projector_bgr: (H, W, 3) uint8, what the projector shows from now on; None = as before.
    """

    stamp: int
    positions: np.ndarray
    base_from_object: np.ndarray
    projector_bgr: np.ndarray | None = None


@dataclass(frozen=True)
class Taken:
    """An image (H, W, 3) uint8 BGR with the true pose base_from_camera (4, 4) at its stamp [ns] and the exposure gain used."""

    stamp: int
    image: np.ndarray
    base_from_camera: np.ndarray
    base_from_object: np.ndarray
    exposure: float


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
        self.show(np.zeros((cell.projector.height, cell.projector.width, 3), np.uint8))

    def show(self, projector_bgr: np.ndarray) -> None:
        """What the projector shows from now on, (H, W, 3) uint8 BGR of the projector's size."""
        expected = (self._cell.projector.height, self._cell.projector.width, 3)
        if projector_bgr.shape != expected:
            raise WorkerError(f"projector image of shape {projector_bgr.shape}, expected {expected}")
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
        move = np.linalg.norm(transforms.difference(first, last)[:3]) / depth + transforms.rotation_angle(first[:3, :3].T @ last[:3, :3])
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


def _serve(pipe: Connection, settings: CellSettings, effects: Effects, self_shadow: bool) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        simulation = CameraSimulation(Cell(settings), effects, self_shadow=self_shadow)
        pipe.send("ready")
        while True:
            exposure = pipe.recv()
            if exposure is None:
                break
            pipe.send(simulation.take(exposure))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        pass
    except Exception as error:  # told to the parent, which stops with one line
        pipe.send(WorkerError(f"rendering failed: {type(error).__name__}: {error}"))


class CameraWorker:
    """Handle of the rendering process, used by one thread of the parent."""

    def __init__(self, settings: CellSettings, effects: Effects, *, self_shadow: bool = True) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, settings, effects, self_shadow), daemon=True)
        self._process.start()
        theirs.close()
        self._busy = True  # until it says ready

    @property
    def busy(self) -> bool:
        """Starting, or an exposure is under way."""
        return self._busy

    def submit(self, exposure: Exposure) -> None:
        """Ask for an exposure; only when not busy."""
        self._busy = True
        self._pipe.send(exposure)

    def poll(self) -> Taken | None:
        """A finished image, if there is one. Raises WorkerError when the process has failed."""
        if not self._pipe.poll():
            if not self._process.is_alive():
                raise WorkerError(f"the rendering process ended with code {self._process.exitcode}")
            return None
        try:
            answer: Any = self._pipe.recv()
        except EOFError:
            raise WorkerError(f"the rendering process ended with code {self._process.exitcode}") from None
        if isinstance(answer, WorkerError):
            raise answer
        self._busy = False
        return answer if isinstance(answer, Taken) else None

    def close(self) -> None:
        """End the process."""
        try:
            self._pipe.send(None)
        except (BrokenPipeError, OSError):
            pass
        self._process.join(2.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(1.0)
        self._pipe.close()

