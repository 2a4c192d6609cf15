"""What the positioner knows of a calibration folder, read again when a file changes."""

import threading
from contextlib import suppress
from pathlib import Path

from numpy import float64
from numpy.typing import NDArray

from sl_common import calibration_files, transforms
from sl_common.errors import CalibrationFileError


class HandEye:
    """Where the camera sits on the flange, and where the projector stands.

    Attributes:
        flange_from_camera: (4, 4) [m]; the identity while there is no calibration, camera poses are then flange poses.
        problem: Why there is none; empty where there is one.
        projector: (3,) the projector's position in the base [m]; None: not known.
    """

    def __init__(self, folder: str) -> None:
        """Watch ``folder``; an empty name means that there is none."""
        self._path = Path(folder).expanduser() / calibration_files.HAND_EYE_FILE if folder else None
        self._lock = threading.Lock()
        self._seen: tuple[tuple[int, int] | None, ...] = ()
        self.projector: NDArray[float64] | None = None
        self.flange_from_camera: NDArray[float64] = transforms.identity()
        self.problem = "no hand-eye calibration: set parameter calibration_folder"
        if self._path is not None:
            self.problem = f"no hand-eye calibration: {self._path} does not exist; calibrate, then save it there"
        self.refresh()

    def refresh(self) -> str:
        """Read the files if they are new or have changed; returns what came of it in a sentence, empty: no change.

        A file that goes away or cannot be read leaves the last good one in use.
        """
        with self._lock:
            return "" if self._path is None else self._read(self._path)

    def _read(self, path: Path) -> str:
        folder = path.parent
        version = tuple(_version(p) for p in (path, folder / calibration_files.PROJECTOR_POSE_FILE))
        if version[0] is None or version == self._seen:
            return ""
        self._seen = version
        with suppress(CalibrationFileError):  # it only makes the stated uncertainty better
            self.projector = calibration_files.load_projector_pose(folder).transform[:3, 3]
        try:
            calibration = calibration_files.load_hand_eye(folder)
        except CalibrationFileError as error:
            if self.problem:
                self.problem = str(error)
                return self.problem
            return f"hand-eye calibration not used, the last good one stays: {error}"
        self.problem = ""
        self.flange_from_camera = calibration.transform
        return f"hand-eye calibration read from {path}"


def _version(path: Path) -> tuple[int, int] | None:
    """Return what changes when a file does; None: there is none."""
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat.st_mtime_ns, stat.st_size
