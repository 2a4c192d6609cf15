"""A bag of the chain's input from the simulated cell, without nodes and clocks: same arguments, same bytes."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Header, String

from pattern_gen import default_pattern
from pattern_gen.ros_conversions import pattern_to_message
from sl_bringup import nominal_calibration
from sl_bringup.bag.writer import BagWriter
from sl_common import transforms
from sl_common.calibration_files import Calibration, PoseCalibration
from sl_common.files import atomic_path, write_text
from sl_common.ros import camera_info, images
from sl_common.ros.stamps import from_ns
from sl_sim import arm
from sl_sim.camera_simulation import CameraSimulation
from sl_sim.cell import Cell, CellSettings, inverse_kinematics
from sl_sim.effects import EFFECTS
from sl_sim.exposures import Exposure

Array = NDArray[np.float64]

CAMERA_FRAME = "camera_optical_frame"
PROJECTOR_FRAME = "projector_optical_frame"
_START = 1_700_000_000_000_000_000
"""Stamp of the first message [ns]; any will do, always the same."""
_MARGIN = 0.3
"""Joint states before the first and after the last image [s]."""


@dataclass(frozen=True, kw_only=True)
class Script:
    """What is recorded.

    Attributes:
        scene: Scene of the cell.
        seed: Of scene, mounting and noise.
        frames: Number of images.
        period: Between images [s].
        joint_rate: Joint states per second.
        approach: Way of the camera along its first optical axis [m].
        roll: Turn of the camera about its optical axis on the way [rad].
        encoder_noise: Standard deviation of the joint states [rad].
        exposure: Exposure time [s].
    """

    scene: str = "wavy"
    seed: int = 1
    frames: int = 5
    period: float = 0.5
    joint_rate: float = 125.0
    approach: float = 0.1
    roll: float = 0.5
    encoder_noise: float = 1.5e-5
    exposure: float = 0.004


def record(folder: Path, script: Script) -> None:
    """Write ``folder``: bag/ with the messages, calibration/ (exact), truth.json and spots.npy.

    truth.json holds the true camera pose of each image by its stamp, spots.npy (rows, cols, 3) the true place of each
    spot in the base frame [m], NaN where it falls on nothing.
    """
    cell = Cell(CellSettings(scene=script.scene, seed=script.seed))
    pattern = default_pattern()
    path = _Path(cell, script)
    begin = _START + round(_MARGIN * 1e9)
    shutters = [begin + round(k * script.period * 1e9) for k in range(script.frames)]
    end = shutters[-1] + round(_MARGIN * 1e9)
    poses: dict[str, list[list[float]]] = {}
    events: list[tuple[int, str, object, bool]] = []

    description = String(data=arm.urdf())
    header = Header(stamp=from_ns(_START), frame_id=PROJECTOR_FRAME)
    events.append((_START, "/robot_description", description, True))
    events.append((_START, "/pattern", pattern_to_message(pattern, header), True))
    events.append((_START, "/projector/camera_info", camera_info.to_message(cell.projector, header), True))

    rng = np.random.default_rng([script.seed, 61])
    step = round(1e9 / script.joint_rate)
    for stamp in range(_START, end + 1, step):
        positions = path.at(stamp) + script.encoder_noise * rng.standard_normal(6)
        message = JointState(name=list(cell.kinematics.joint_names), position=positions.tolist())
        message.header.stamp = from_ns(stamp)
        events.append((stamp, "/joint_states", message, False))

    simulation = CameraSimulation(cell, EFFECTS["lab"])
    simulation.show(np.ascontiguousarray(pattern.render()[..., ::-1]))
    half = round(0.5e9 * script.exposure)
    for stamp in shutters:
        instants = np.stack([path.at(t) for t in np.linspace(stamp - half, stamp + half, 7).astype(np.int64)])
        taken = simulation.take(Exposure(stamp, instants, cell.base_from_object))
        header = Header(stamp=from_ns(stamp), frame_id=CAMERA_FRAME)
        events.append((stamp, "/camera/image_raw", images.to_message(taken.image, header), False))
        events.append((stamp, "/camera/camera_info", camera_info.to_message(cell.camera, header), False))
        poses[str(stamp)] = taken.base_from_camera.tolist()

    with BagWriter(folder / "bag") as bag:
        for stamp, topic, message, latched in sorted(events, key=lambda e: e[0]):
            bag.write(topic, message, stamp, latched=latched)
    _save_truth(folder, cell, pattern.centers, pattern.pattern_id, poses)


def _save_truth(folder: Path, cell: Cell, centers: Array, pattern_id: str, poses: dict[str, list[list[float]]]) -> None:
    exact = Calibration(
        cell.camera,
        cell.projector,
        PoseCalibration(cell.flange_from_camera),
        PoseCalibration(cell.base_from_projector),
    )
    note = "exact values of the simulated cell; not the result of a calibration"
    nominal_calibration.save(folder / "calibration", exact, note=note, pattern_id=pattern_id, date="simulated")
    spots, _ = cell.spots_in_base(centers.reshape(-1, 2))
    with atomic_path(folder / "spots.npy") as temporary:
        np.save(temporary, spots.reshape(centers.shape[:2] + (3,)).astype(np.float32))
    truth = {"cell": cell.truth()["cell"], "base_from_camera": poses}
    write_text(folder / "truth.json", json.dumps(truth, indent=1) + "\n")


class _Path:
    """The joints over time: from the cell's start pose nearer to the object, at rest at both ends."""

    def __init__(self, cell: Cell, script: Script) -> None:
        self._first = np.asarray(cell.start_positions)
        step = transforms.make(transforms.rotation_exp((0.0, 0.0, script.roll)), np.array([0.0, 0.0, script.approach]))
        goal = cell.base_from_camera(self._first) @ step @ transforms.inverse(cell.flange_from_camera)
        self._last = inverse_kinematics(cell.kinematics, goal, self._first)
        self._duration = (script.frames - 1) * script.period

    def at(self, stamp: int) -> Array:
        """Return the joint positions (6,) at ``stamp`` [ns] on a minimum-jerk path."""
        s = np.clip(((stamp - _START) * 1e-9 - _MARGIN) / self._duration, 0.0, 1.0)
        return self._first + s**3 * (10 - 15 * s + 6 * s * s) * (self._last - self._first)
