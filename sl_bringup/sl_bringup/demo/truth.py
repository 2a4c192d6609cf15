"""What the simulated cell knows and no node is told: used for the report, and for a nominal calibration."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sl_bringup.errors import DemoError
from sl_common.calibration_files import Calibration, PoseCalibration
from sl_common.cameras import CameraModel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Truth:
    """The cell's ~/truth.

    Attributes:
        camera: True camera.
        projector: True projector.
        flange_from_camera: (4, 4) [m].
        base_from_projector: (4, 4) [m].
        report: The arm driver's counters.
        data: Everything, as sent.
    """

    camera: CameraModel
    projector: CameraModel
    flange_from_camera: Array
    base_from_projector: Array
    report: dict[str, Any]
    data: dict[str, Any]

    @property
    def calibration(self) -> Calibration:
        """The perfect calibration."""
        return Calibration(
            self.camera,
            self.projector,
            PoseCalibration(self.flange_from_camera),
            PoseCalibration(self.base_from_projector),
        )

    @property
    def violations(self) -> int:
        """Limit violations that the driver counted, of all kinds."""
        return sum(int(n) for n in self.report["violations"].values())


def parse(text: str) -> Truth:
    """Read the JSON of ~/truth; raises DemoError when an entry is missing."""
    data = json.loads(text)
    try:
        return Truth(
            camera=_camera(data["camera"]),
            projector=_camera(data["projector"]),
            flange_from_camera=np.array(data["flange_from_camera"], dtype=np.float64),
            base_from_projector=np.array(data["base_from_projector"], dtype=np.float64),
            report=data["report"],
            data=data,
        )
    except KeyError as error:
        raise DemoError(f"the cell's truth lacks {error}: is the cell of another version?") from None


def _camera(data: dict[str, Any]) -> CameraModel:
    return CameraModel(
        int(data["width"]),
        int(data["height"]),
        np.array(data["matrix"], dtype=np.float64),
        data["distortion_model"],
        tuple(data["coefficients"]),
    )
