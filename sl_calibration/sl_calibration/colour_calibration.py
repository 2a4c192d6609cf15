"""Colour and intensity calibration (section III.B): from chart samples to the letters' drive values and
colours.yaml."""

import os
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pattern_gen.pattern import Letter
from sl_calibration.colour_charts import ChartSamples
from sl_calibration.colour_letters import LetterOptions, choose_letters, least_distance
from sl_calibration.colour_response import CHANNELS, ColourModel, fit_response
from sl_common.calibration_files import provenance
from sl_common.files import write_yaml

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ColourCalibration:
    """Calibrated letters.

    Attributes:
        model: Responses and mixing.
        drives: (A, 3) uint8 new drive values of the letters, R G B.
        camera: (A, 3) camera values above black that they are expected to have, R G B.
        shapes: Shape of each letter.
        least_before: Least distance between two letters of the pattern as it was [camera grey levels].
        least_after: The same with the new drive values.
        samples: Number of chart patches.
    """

    model: ColourModel
    drives: NDArray[np.uint8]
    camera: Array
    shapes: tuple[str, ...]
    least_before: float
    least_after: float
    samples: int


class HasLetters(Protocol):
    """A pattern, of which the letters count."""

    @property
    def letters(self) -> tuple[Letter, ...]:
        """Drive values and shapes."""
        ...


def calibrate_colours(
    samples: ChartSamples,
    pattern: HasLetters,
    options: LetterOptions | None = None,
    *,
    adapt_to_scene: bool = False,
) -> ColourCalibration:
    """Fit the response and choose the letters.

    Args:
        samples: Of the charts.
        pattern: Its letters' shapes and number; its colours are what the new ones are compared with.
        options: See LetterOptions.
        adapt_to_scene: Choose for all surfaces of the scene, not only the typical one (Caspi).

    Raises:
        InvalidInputError: as fit_response and choose_letters.
    """
    model = fit_response(samples.drives, samples.camera)
    shapes = tuple(letter.shape for letter in pattern.letters)
    before = np.array([letter.rgb for letter in pattern.letters], dtype=np.float64)
    seen_before = np.minimum(model.camera(before), 255.0)
    albedos = samples.albedos if adapt_to_scene else None
    drives = choose_letters(model, shapes, options, albedos=albedos, like=seen_before)
    camera = model.camera(drives)
    return ColourCalibration(
        model,
        drives,
        camera,
        shapes,
        least_distance(seen_before, shapes),
        least_distance(camera, shapes),
        len(samples.drives),
    )


def save_colours(path: str | os.PathLike[str], result: ColourCalibration) -> None:
    """Write colours.yaml: date, units, residuals, samples; responses, mixing, camera_gamma; letters with rgb,
    camera_rgb."""
    model = result.model
    residuals = {"fit_rms_grey_levels": model.rms}
    data: dict[str, Any] = provenance(samples=result.samples, residuals=residuals)
    data["units"] = "projector drive values 0..255; camera grey levels above black 0..255; R G B"
    data["responses"] = {
        name: {"drive": model.levels.round(3), "light": model.responses[k].round(6)} for k, name in enumerate(CHANNELS)
    }
    data["mixing"] = model.mixing.round(6)
    data["camera_gamma"] = model.gamma.round(6)
    data["least_distance"] = {"before": round(result.least_before, 3), "after": round(result.least_after, 3)}
    data["letters"] = [
        {"rgb": drives, "shape": shape, "camera_rgb": camera.round(3)}
        for drives, shape, camera in zip(result.drives.tolist(), result.shapes, result.camera, strict=True)
    ]
    write_yaml(path, data)
