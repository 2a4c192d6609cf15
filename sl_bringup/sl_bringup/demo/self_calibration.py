"""The first act: the system calibrates itself by the calibrator's services, knowing only its own motion."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from std_srvs.srv import Trigger

from sl_bringup.demo.report import Row
from sl_bringup.demo.truth import Truth
from sl_bringup.errors import DemoError
from sl_bringup.ros.session import Session
from sl_bringup.terminal import Terminal
from sl_common import transforms
from sl_common.calibration_files import load_calibration
from sl_msgs.srv import ComputeCalibration, SaveCalibration

CALIBRATOR = "calibrator"


@dataclass(frozen=True)
class Outcome:
    """How the self-calibration went.

    Attributes:
        duration: Wall time of motion, samples and computation [s].
        samples: Number of views.
        rms: Reprojection residual [px].
        rms_left_out: Residual of views left out of the fit [px].
    """

    duration: float
    samples: int
    rms: float
    rms_left_out: float


def self_calibrate(session: Session, terminal: Terminal) -> Outcome:
    """Let the calibrator drive its motion, compute and save; raises DemoError with the reason where one fails."""
    observer = session.observer
    terminal.step("self-calibration: the arm moves, the projector stays, no grid")
    started = time.monotonic()
    seen = len(observer.record.dots)
    session.wait_for(lambda: len(observer.record.dots) > seen + 3, 60.0, "decoded images at a steady rate")

    def live() -> str:
        progress = observer.latest.get(f"{CALIBRATOR}/progress")
        dots = observer.record.dots[-1][1] if observer.record.dots else 0
        return f"{progress.samples if progress else 0} samples; {dots} dots"

    def call(kind: Any, name: str, request: Any, timeout: float) -> Any:
        client = session.thread.run(lambda: observer.create_client(kind, f"{CALIBRATOR}/{name}"))
        session.wait_for(client.service_is_ready, 30.0, f"the service ~/{name} (calibrator)")
        future = session.thread.run(lambda: client.call_async(request))
        session.wait_for(future.done, timeout, f"an answer of ~/{name} (calibrator)", live)
        answer = future.result()
        session.thread.run(lambda: observer.destroy_client(client))
        if not answer.success:
            raise DemoError(f"self-calibration, {name}: {answer.message}")
        terminal.step(f"  {name}: {answer.message}")
        return answer

    call(Trigger, "run_motion", Trigger.Request(), 600.0)
    computed = call(ComputeCalibration, "compute", ComputeCalibration.Request(), 180.0)
    call(SaveCalibration, "save", SaveCalibration.Request(), 20.0)
    duration = time.monotonic() - started
    session.wait(2.5)  # triangulator and positioner look for new files once a second
    return Outcome(duration, computed.samples, computed.rms, computed.rms_left_out)


def rows(folder: Path, truth: Truth, outcome: Outcome | None) -> list[Row]:
    """Compare the calibration in use with the truth."""
    used = load_calibration(folder)
    hand_eye = transforms.difference(truth.flange_from_camera, used.flange_from_camera.transform)
    pose = transforms.difference(truth.base_from_projector, used.base_from_projector.transform)
    true, found = truth.projector.matrix, used.projector.matrix
    out = [
        Row("hand-eye transform, position error", _mm(hand_eye), "mm"),
        Row("hand-eye transform, orientation error", _degrees(hand_eye), "deg", digits=3),
        Row("projector pose, position error", _mm(pose), "mm"),
        Row("projector pose, orientation error", _degrees(pose), "deg", digits=3),
        Row("projector focal length, error", 100 * abs(found[0, 0] / true[0, 0] - 1), "%", digits=3),
        Row("projector principal point, error", float(np.linalg.norm(found[:2, 2] - true[:2, 2])), "px"),
    ]
    if outcome is not None:
        out += [
            Row("self-calibration, views", outcome.samples, "", digits=0),
            Row("self-calibration, residual", outcome.rms, "px", digits=3),
            Row("self-calibration, residual of views left out", outcome.rms_left_out, "px", digits=3),
            Row("self-calibration, wall time", outcome.duration, "s", digits=0),
        ]
    return out


def _mm(delta: np.ndarray) -> float:
    return 1e3 * float(np.linalg.norm(delta[:3]))


def _degrees(delta: np.ndarray) -> float:
    return float(np.degrees(np.linalg.norm(delta[3:])))
