"""The hand-eye transform of a calibration folder, read again when its file changes."""

from pathlib import Path

from numpy import float64
from numpy.typing import NDArray
from sl_common.errors import CalibrationFileError

from sl_common import calibration_files, transforms


class HandEye:
    """Where the camera sits on the flange.

    Attributes:
        flange_from_camera: (4, 4) [m]; the identity while there is no calibration, camera poses are then flange poses.
        problem: Why there is none; empty where there is one.
    """

    def __init__(self, folder: str) -> None:
        self._path = Path(folder).expanduser() / calibration_files.HAND_EYE_FILE if folder else None
        self._seen: tuple[int, int] | None = None
        self.flange_from_camera: NDArray[float64] = transforms.identity()
        self.problem = "no hand-eye calibration: set parameter calibration_folder"
        self.refresh()

    def refresh(self) -> bool:
        """Read the file if it is new or has changed; returns whether anything changed.

        A file that cannot be read leaves the last good transform in use and says so in ``problem`` only if there was
        none.
        """
        if self._path is None:
            return False
        try:
            stat = self._path.stat()
        except OSError:
            missing = f"no hand-eye calibration: {self._path} does not exist; calibrate, then save it there"
            changed = self._seen is None and self.problem != missing
            if self._seen is None:
                self.problem = missing
            return changed
        version = (stat.st_mtime_ns, stat.st_size)
        if version == self._seen:
            return False
        try:
            calibration = calibration_files.load_hand_eye(self._path.parent)
        except CalibrationFileError as error:
            changed = str(error) != self.problem
            self.problem = str(error) if self._seen is None else self.problem
            return changed and self._seen is None
        self._seen, self.problem = version, ""
        self.flange_from_camera = calibration.transform
        return True
