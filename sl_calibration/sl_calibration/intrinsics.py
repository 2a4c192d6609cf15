"""Intrinsics as a vector of parameters for adjustment: none, Pers tied to the focal length or free, plumb_bob.

The vector is (log fx, log fy/fx, cx, cy, coefficients). Pers tied is the paper's choice (section III.B): its f is the
focal length, 1 in normalised units; Pers free has log f; plumb_bob has k1 k2 p1 p2 k3.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]

MODELS = ("none", "pers_tied", "pers_free", "plumb_bob")
"""Distortion models, simplest first."""

_COEFFICIENT_MEAN = {"none": (), "pers_tied": (), "pers_free": (0.7,), "plumb_bob": (0.0,) * 5}
_COEFFICIENT_STEP = {"none": (), "pers_tied": (), "pers_free": (1e-4,), "plumb_bob": (1e-4, 1e-4, 1e-5, 1e-5, 1e-4)}


@dataclass(frozen=True)
class Priors:
    """What is believed of intrinsics before any image: wide enough that images which determine them decide.

    Attributes:
        focal: One sigma of log fx around the image width.
        aspect: One sigma of log(fy / fx) around square pixels.
        center_x: One sigma of cx around the middle, in image widths.
        center_y: One sigma of cy around the middle, in image heights.
        radial: One sigma of k1, k2 and k3.
        tangential: One sigma of p1 and p2.
        pers: One sigma of log f of the Pers model around log 2.
    """

    focal: float = 1.5
    aspect: float = 0.01
    center_x: float = 0.1
    center_y: float = 0.1
    radial: float = 1.0
    tangential: float = 0.01
    pers: float = 1.5


CAMERA_PRIORS = Priors()
PROJECTOR_PRIORS = Priors(center_x=0.5, center_y=1.0, radial=0.2, tangential=0.005)
"""A projector's lens may be shifted by half its panel and more; its distortion is small."""


@dataclass(frozen=True)
class Parametrisation:
    """How a vector of parameters becomes a camera model.

    Attributes:
        model: One of MODELS.
        width: Image width [px].
        height: Image height [px].
    """

    model: str
    width: int
    height: int

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise InvalidInputError(f"unknown model '{self.model}': use one of {', '.join(MODELS)}")

    @property
    def size(self) -> int:
        """Number of parameters."""
        return 4 + len(_COEFFICIENT_MEAN[self.model])

    @property
    def steps(self) -> Array:
        """(size,) steps for numerical differences."""
        return np.array((1e-5, 1e-5, 1e-2, 1e-2, *_COEFFICIENT_STEP[self.model]))

    def prior(self, priors: Priors) -> tuple[Array, Array]:
        """Return mean and standard deviation (size,) of the parameters before any observation."""
        mean = (np.log(self.width), 0.0, (self.width - 1) / 2, (self.height - 1) / 2, *_COEFFICIENT_MEAN[self.model])
        sigma = [priors.focal, priors.aspect, priors.center_x * self.width, priors.center_y * self.height]
        if self.model == "pers_free":
            sigma.append(priors.pers)
        if self.model == "plumb_bob":
            sigma += [priors.radial, priors.radial, priors.tangential, priors.tangential, priors.radial]
        return np.array(mean), np.array(sigma)

    def camera(self, parameters: Array) -> CameraModel:
        """Return the camera model of a vector (size,)."""
        focal, aspect, cx, cy = parameters[:4]
        fx = float(np.exp(np.clip(focal, -20, 20)))
        fy = fx * float(np.exp(np.clip(aspect, -5, 5)))
        matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
        rest = parameters[4:]
        if self.model == "none":
            return CameraModel(self.width, self.height, matrix)
        if self.model == "pers_tied":
            return CameraModel(self.width, self.height, matrix, "pers", (1.0,))
        if self.model == "pers_free":
            return CameraModel(self.width, self.height, matrix, "pers", (float(np.exp(np.clip(rest[0], -5, 8))),))
        return CameraModel(self.width, self.height, matrix, "plumb_bob", tuple(rest))

    def start(self, matrix: Array) -> Array:
        """Return the vector of a camera matrix (3, 3) with the model's mildest distortion."""
        head = (np.log(matrix[0, 0]), np.log(matrix[1, 1] / matrix[0, 0]), matrix[0, 2], matrix[1, 2])
        return np.array((*head, *_COEFFICIENT_MEAN[self.model]))

    def summary(self, parameters: Array, sigma: Array) -> dict[str, dict[str, float]]:
        """Return value and one sigma of fx, fy, cx, cy [px] and of the coefficients, by name."""
        camera = self.camera(parameters)
        fx, fy = camera.matrix[0, 0], camera.matrix[1, 1]
        values = {
            "fx": (fx, fx * sigma[0]),
            "fy": (fy, fy * float(np.hypot(sigma[0], sigma[1]))),
            "cx": (camera.matrix[0, 2], sigma[2]),
            "cy": (camera.matrix[1, 2], sigma[3]),
        }
        if self.model == "pers_free":
            values["pers_f"] = (camera.coefficients[0], camera.coefficients[0] * sigma[4])
        if self.model == "plumb_bob":
            values |= {n: (parameters[4 + k], sigma[4 + k]) for k, n in enumerate(("k1", "k2", "p1", "p2", "k3"))}
        return {name: {"value": float(value), "sigma": float(one)} for name, (value, one) in values.items()}
