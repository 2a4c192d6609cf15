"""The cell's camera in a process of its own, so that rendering never delays the arm.

The worker builds the same cell from the same settings and renders one exposure at a time; the parent asks, goes on,
and polls.
"""

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

from sl_common.errors import StructuredLightError
from sl_sim.cell import Cell, CellSettings
from sl_sim.effects import Effects
from sl_sim.exposures import Exposure, Taken


class WorkerError(StructuredLightError):
    """The rendering process has failed."""


def _serve(pipe: Connection, settings: CellSettings, effects: Effects, self_shadow: bool) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(5)  # an image may be late, a control period may not
    try:
        import cv2

        from sl_sim.camera_simulation import CameraSimulation  # here: the parent needs neither compiler nor ray caster

        cv2.setNumThreads(1)
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


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Processes started inside use one thread for linear algebra: a second one is waited for on a busy machine."""
    before = os.environ.get("OPENBLAS_NUM_THREADS")
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["OPENBLAS_NUM_THREADS"]
        else:
            os.environ["OPENBLAS_NUM_THREADS"] = before


class CameraWorker:
    """Handle of the rendering process, used by one thread of the parent."""

    def __init__(self, settings: CellSettings, effects: Effects, *, self_shadow: bool = True) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, settings, effects, self_shadow), daemon=True)
        with _one_thread():
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
        with contextlib.suppress(BrokenPipeError, OSError):
            self._pipe.send(None)
        self._process.join(2.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join(1.0)
        self._pipe.close()
