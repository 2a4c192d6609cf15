"""The hand-eye transform of a calibration folder, read again when its file changes."""

from pathlib import Path

from numpy import float64
from numpy.typing import NDArray

from sl_common import calibration_files, transforms
from sl_common.errors import CalibrationFileError


class HandEye:
    """Where the camera sits on the flange.

    Attributes:
        flange_from_camera: (4, 4) [m]; the identity while there is no calibration, camera poses are then flange poses.
        problem: Why there is none; empty where there is one.
    """

    def __init__(self, folder: str) -> None:
        """Watch ``folder``; an empty name means that there is none."""
        self._path = Path(folder).expanduser() / calibration_files.HAND_EYE_FILE if folder else None
        self._seen: tuple[int, int] | None = None
        self.flange_from_camera: NDArray[float64] = transforms.identity()
        self.problem = "no hand-eye calibration: set parameter calibration_folder"
        if self._path is not None:
            self.problem = f"no hand-eye calibration: {self._path} does not exist; calibrate, then save it there"
        self.refresh()

    def refresh(self) -> str:
        """Read the file if it is new or has changed; returns what came of it in a sentence, empty: no change.

        A file that goes away or cannot be read leaves the last good transform in use.
        """
        if self._path is None:
            return ""
        try:
            stat = self._path.stat()
        except OSError:
            return ""
        version = (stat.st_mtime_ns, stat.st_size)
        if version == self._seen:
            return ""
        self._seen = version
        try:
            calibration = calibration_files.load_hand_eye(self._path.parent)
        except CalibrationFileError as error:
            if self.problem:
                self.problem = str(error)
                return self.problem
            return f"hand-eye calibration not used, the last good one stays: {error}"
        self.problem = ""
        self.flange_from_camera = calibration.transform
        return f"hand-eye calibration read from {self._path}"
