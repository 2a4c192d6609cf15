"""Calibration sessions: samples kept in a folder, one file each, so that they survive a restart.

Layout: session.yaml (procedure, pattern), camera.yaml, pattern.npz, and samples/NNNNNN.npz. Every file is written whole
or not at all; a sample that cannot be read is reported and left alone.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pattern_gen.pattern import Letter
from sl_common.calibration_files import CAMERA_FILE, load_camera, save_camera
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError, StructuredLightError
from sl_common.files import atomic_path, read_yaml, write_yaml

Array = NDArray[np.float64]

SESSION_FILE = "session.yaml"
_PATTERN_FILE = "pattern.npz"
_SAMPLES = "samples"


@dataclass(frozen=True, eq=False)
class SessionPattern:
    """What a session needs of the projected pattern.

    Attributes:
        pattern_id: Content hash.
        centers: (rows, cols, 2) spot centres [projector px].
        size: Width and height of the projector image [px].
        spot_diameter: [projector px].
        letters: Drive values and shapes.
    """

    pattern_id: str
    centers: Array
    size: tuple[int, int]
    spot_diameter: float
    letters: tuple[Letter, ...] = ()


@dataclass(frozen=True, eq=False)
class Sample:
    """One sample: what a procedure measured at one moment.

    Attributes:
        name: Used in messages.
        stamp: Of the image [ns].
        arrays: The measurement; names and shapes are the procedure's.
    """

    name: str
    stamp: int
    arrays: dict[str, NDArray[Any]]


class Session:
    """Samples in a folder. Samples are numbered from 0 in the order taken; removal renumbers those after.

    Attributes:
        folder: Where the session is kept.
        procedure: Of the session: self, camera, procam, hand_eye or colours.
        notes: Files that could not be read.
    """

    def __init__(self, folder: str | os.PathLike[str], procedure: str = "self") -> None:
        """Open the session in a folder, or begin one there.

        Raises CalibrationFileError for an unreadable session.yaml, InvalidInputError for another procedure's session,
        StructuredLightError for a folder that cannot be written.
        """
        self.folder = Path(folder).expanduser().resolve()
        self.procedure = procedure
        self.notes: list[str] = []
        self._camera: CameraModel | None = None
        self._pattern: SessionPattern | None = None
        self._samples: list[tuple[Path, Sample]] = []
        try:
            (self.folder / _SAMPLES).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StructuredLightError(f"{self.folder}: session cannot be kept there: {error.strerror}") from None
        if (self.folder / SESSION_FILE).exists():
            self._read()
        else:
            self._write()

    @staticmethod
    def is_session(folder: str | os.PathLike[str]) -> bool:
        """Tell whether a folder holds a session."""
        return (Path(folder).expanduser() / SESSION_FILE).exists()

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def samples(self) -> list[Sample]:
        """The samples, oldest first."""
        return [sample for _, sample in self._samples]

    @property
    def camera(self) -> CameraModel | None:
        """The camera model that the samples were taken with."""
        return self._camera

    @property
    def pattern(self) -> SessionPattern | None:
        """The pattern that was projected."""
        return self._pattern

    def set_camera(self, camera: CameraModel) -> None:
        """Set the camera model; raises InvalidInputError for another image size than that of the samples."""
        known = self._camera
        if known is not None and self._samples and (known.width, known.height) != (camera.width, camera.height):
            raise InvalidInputError(
                f"images are {camera.width}x{camera.height} px but the session's are {known.width}x{known.height}:"
                " begin another session"
            )
        self._camera = camera
        save_camera(self.folder / CAMERA_FILE, camera)

    def set_pattern(self, pattern: SessionPattern) -> None:
        """Set the pattern; raises InvalidInputError for another pattern than that of the samples."""
        known = self._pattern
        if known is not None and self._samples and known.pattern_id != pattern.pattern_id:
            raise InvalidInputError(
                f"pattern '{pattern.pattern_id}' is shown but the session's samples are of '{known.pattern_id}':"
                " show that one or begin another session"
            )
        self._pattern = pattern
        with atomic_path(self.folder / _PATTERN_FILE) as path:
            np.savez(path, centers=pattern.centers)
        self._write()

    def add(self, sample: Sample) -> int:
        """Keep a sample; returns its index."""
        number = 1 + max((int(path.stem) for path, _ in self._samples), default=-1)
        path = self.folder / _SAMPLES / f"{number:06d}.npz"
        with atomic_path(path) as temporary:
            np.savez(temporary, name=sample.name, stamp=sample.stamp, **sample.arrays)  # type: ignore[arg-type]
        self._samples.append((path, sample))
        return len(self._samples) - 1

    def remove(self, index: int) -> str:
        """Remove a sample, -1: the last; returns its name. Raises InvalidInputError for an index that is not there."""
        count = len(self._samples)
        if count == 0 or not -1 <= index < count:
            raise InvalidInputError(f"no sample {index}: the session has {count}, numbered from 0")
        path, sample = self._samples.pop(index)
        path.unlink(missing_ok=True)
        return sample.name

    def _write(self) -> None:
        data: dict[str, Any] = {"procedure": self.procedure}
        if self._pattern is not None:
            data["pattern"] = {
                "pattern_id": self._pattern.pattern_id,
                "projector": {"width": self._pattern.size[0], "height": self._pattern.size[1]},
                "spot_diameter": self._pattern.spot_diameter,
                "letters": [{"rgb": list(x.rgb), "shape": x.shape} for x in self._pattern.letters],
            }
        write_yaml(self.folder / SESSION_FILE, data)

    def _read(self) -> None:
        data = read_yaml(self.folder / SESSION_FILE)
        if data.get("procedure", self.procedure) != self.procedure:
            raise InvalidInputError(
                f"{self.folder}: a session of procedure '{data.get('procedure')}', not '{self.procedure}':"
                " give another session folder"
            )
        if (self.folder / CAMERA_FILE).exists():
            self._camera = load_camera(self.folder / CAMERA_FILE)
        entry = data.get("pattern")
        if entry and (self.folder / _PATTERN_FILE).exists():
            try:
                with np.load(self.folder / _PATTERN_FILE) as file:
                    centers = file["centers"]
                size = (int(entry["projector"]["width"]), int(entry["projector"]["height"]))
                letters = tuple(Letter(tuple(x["rgb"]), str(x["shape"])) for x in entry.get("letters", ()))
                self._pattern = SessionPattern(
                    str(entry["pattern_id"]), centers, size, float(entry["spot_diameter"]), letters
                )
            except (KeyError, TypeError, ValueError, OSError, StructuredLightError) as error:
                raise InvalidInputError(f"{self.folder}: the session's pattern cannot be read: {error}") from None
        for path in sorted((self.folder / _SAMPLES).glob("[0-9]*.npz")):
            try:
                self._samples.append((path, _load_sample(path)))
            except (KeyError, ValueError, OSError, EOFError, StructuredLightError) as error:
                self.notes.append(f"{path}: sample cannot be read and is left out: {error}")


def _load_sample(path: Path) -> Sample:
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files if key not in ("name", "stamp")}
        return Sample(str(file["name"]), int(file["stamp"]), arrays)
