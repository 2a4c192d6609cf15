"""What the camera sees of the projector's drive values (section III.B): responses and mixing of the channels.

    camera_j = 255 * (sum_i mixing_ji * response_i(drive_i)) ** (1 / gamma_j)      above black, R G B

Projector responses are monotone, 0 at 0 and 1 at 255. The mixing holds the overlap of the two sets of colour filters,
the gains and the surface's albedo. The exponent stands for the camera's own response: a surface of other albedo then
scales the values of each channel, which the rest of the calibration relies on.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]

CHANNELS = ("red", "green", "blue")
SATURATED = 250.0
_FEW_LEVELS = 5


@dataclass(frozen=True, eq=False)
class ColourModel:
    """A fitted response.

    Attributes:
        levels: (L,) drive values of the responses' knots, from 0 to 255.
        responses: (3, L) light of each projector channel at the knots, 0 to 1.
        mixing: (3, 3) camera channel j of projector channel i.
        gamma: (3,) exponent of each camera channel.
        rms: RMS of the fit's residuals [camera grey levels].
    """

    levels: Array
    responses: Array
    mixing: Array
    gamma: Array
    rms: float

    def light(self, drives: ArrayLike) -> Array:
        """Return the light (..., 3) of drive values (..., 3), 0..255, R G B."""
        drives = np.asarray(drives, dtype=np.float64)
        return np.stack([np.interp(drives[..., k], self.levels, self.responses[k]) for k in range(3)], axis=-1)

    def camera(self, drives: ArrayLike) -> Array:
        """Return the camera values above black (..., 3) of drive values (..., 3), R G B; not clipped at 255."""
        return 255.0 * np.maximum(self.light(drives) @ self.mixing.T, 0.0) ** (1 / self.gamma)


def fit_response(drives: ArrayLike, camera: ArrayLike) -> ColourModel:
    """Fit the model to a chart.

    Args:
        drives: (K, 3) projector drive values, 0..255, R G B.
        camera: (K, 3) camera values above black, R G B; saturated ones are ignored.

    Raises:
        InvalidInputError: too few patches, a camera that saturates or sees nothing, a chart in the wrong order.
    """
    drives = np.asarray(drives, dtype=np.float64).reshape(-1, 3)
    camera = np.asarray(camera, dtype=np.float64).reshape(-1, 3)
    usable = np.isfinite(camera) & (camera < SATURATED)
    if len(drives) < 8 or usable.sum() < 20:
        raise InvalidInputError(
            f"{usable.sum()} usable values of {len(drives)} patches (saturated ones do not count): lower the"
            f" exposure, or"
            " show the whole chart"
        )
    if np.nanmax(camera) < 10:
        raise InvalidInputError(
            f"the chart's brightest value is {np.nanmax(camera):.1f} above black: raise the exposure"
        )
    levels = np.unique(np.concatenate([[0.0, 255.0], drives.ravel()]))
    smooth = len(levels) <= _FEW_LEVELS
    start = np.concatenate([np.full(3, np.log(2.2)), _first_mixing(drives, camera, usable), np.full(3, np.log(1.5))])
    if not smooth:
        steps = np.diff((levels / 255.0) ** 2.2)
        start = np.concatenate([np.tile(np.log(steps), 3), start[3:]])
    count = 3 if smooth else 3 * (len(levels) - 1)

    def model(p: Array) -> ColourModel:
        if smooth:
            fine = np.linspace(0, 255, 52)
            responses = np.stack([(fine / 255) ** np.exp(power) for power in p[:3]])
            knots = fine
        else:
            increments = np.exp(p[:count].reshape(3, -1))
            responses = np.concatenate([np.zeros((3, 1)), np.cumsum(increments, axis=1)], axis=1)
            responses = responses / responses[:, -1:]
            knots = levels
        return ColourModel(knots, responses, p[count : count + 9].reshape(3, 3), np.exp(p[count + 9 :]), 0.0)

    def residuals(p: Array) -> Array:
        fitted = model(p)
        difference = np.where(usable, fitted.camera(drives) - camera, 0.0).ravel()
        if smooth:
            return difference
        curve = np.diff(
            p[:count].reshape(3, -1), n=1, axis=1
        ).ravel()  # steps between neighbouring levels differ little
        return np.concatenate([difference, 0.3 * curve, 0.3 * (p[count + 9 :] - np.log(1.5))])

    solution = least_squares(residuals, start, loss="soft_l1", f_scale=3.0, max_nfev=300)
    fitted = model(solution.x)
    error = np.where(usable, fitted.camera(drives) - camera, np.nan)
    rms = float(np.sqrt(np.nanmean(error**2)))
    if rms > 0.15 * float(np.nanmax(camera)):
        raise InvalidInputError(
            f"the chart does not fit any response: {rms:.1f} grey levels RMS of {np.nanmax(camera):.0f}; are the"
            f" images in"
            " the order of projection, with automatic exposure and white balance off?"
        )
    return ColourModel(fitted.levels, fitted.responses, fitted.mixing, fitted.gamma, rms)


def _first_mixing(drives: Array, camera: Array, usable: NDArray[np.bool_]) -> Array:
    """Linear least squares of the mixing with the starting exponents, (9,)."""
    light = (drives / 255.0) ** 2.2
    linear = (np.maximum(camera, 0.0) / 255.0) ** 1.5
    rows = []
    for channel in range(3):
        good = usable[:, channel]
        rows.append(np.linalg.lstsq(light[good], linear[good, channel], rcond=None)[0])
    return np.maximum(np.array(rows), 1e-3).ravel()
