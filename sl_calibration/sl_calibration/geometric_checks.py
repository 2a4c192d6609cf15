"""Checks that the calibration and the previous cloud allow: dots that are probably wrong are marked, with the reason.

A wrong code puts a dot at a wrong place of the projector image. The epipolar line catches it unless the error lies
along the line; the triangulator refuses such dots. What is left shows as a wrong depth. The projector stands still, so
a dot of a surface at rest keeps its point in the base frame whatever the camera does: the previous cloud, seen by the
present camera, predicts each pixel. A dot that is elsewhere while the dots around it are not has jumped alone. It
is marked but kept, since the rim of a moving object does the same for one cloud: where an object moves, the dots on it
move together and are not marked.

The core is plain functions; nothing is kept but the previous cloud that the caller hands back.
"""

from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sl_calibration.triangulation import Rejection, Triangulation
from sl_common import transforms
from sl_common.cameras import CameraModel

Array = NDArray[np.float64]

_STRIDE = 1 << 16  # of a dot's key: row * _STRIDE + col
_AROUND = np.array([i * _STRIDE + j for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)])
_NORMAL = 1.4826  # standard deviations of a normal distribution per median absolute deviation


class Mark(IntEnum):
    """Why a dot is marked: what :class:`Rejection` says, and what the previous cloud adds."""

    NONE = Rejection.NONE
    NOT_FINITE = Rejection.NOT_FINITE
    EPIPOLAR = Rejection.EPIPOLAR
    BEHIND = Rejection.BEHIND
    PARALLEL = Rejection.PARALLEL
    JUMPED = 5
    """Elsewhere than the previous cloud predicts, and the dots around it are not: kept, but not to be trusted."""


@dataclass(frozen=True, kw_only=True)
class CheckOptions:
    """How to check.

    Attributes:
        sigmas: Robust standard deviations of the image's own dots beyond which a dot is marked.
        least_gate: No dot nearer than this to its line or its prediction is marked [px].
        longest: Age beyond which a point of the previous clouds predicts nothing [s].
        company: Dots around one that must have moved as it did; with fewer seen before it is not judged.
    """

    sigmas: float = 6.0
    least_gate: float = 0.5
    longest: float = 1.0
    company: int = 2


@dataclass(frozen=True, eq=False)
class PreviousCloud:
    """The latest point of every dot seen lately, sorted by key.

    Attributes:
        key: (M,) int64, row * 65536 + col. points: (M, 3) in the base frame [m]. stamp: (M,) int64 [ns].
    """

    key: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    points: Array = field(default_factory=lambda: np.empty((0, 3)))
    stamp: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))


def epipolar_gate(distance: ArrayLike, largest: float, options: CheckOptions | None = None) -> float:
    """Return the distance from the epipolar line [px] beyond which a dot of this image is marked.

    Args:
        distance: (N,) distances of the image's dots [px], NaN where unknown. Most of them must be right.
        largest: The most that the gate may be [px], which a calibration that is off reaches.
        options: See there.
    """
    options = options or CheckOptions()
    known = np.abs(np.asarray(distance, dtype=np.float64))
    known = known[np.isfinite(known)]
    if len(known) == 0:
        return largest
    return float(min(largest, max(options.least_gate, options.sigmas * _NORMAL * np.median(known))))


def refuse_off_line(result: Triangulation, gate: float) -> Triangulation:
    """Return the triangulation with good dots farther than ``gate`` [px] from their lines refused as EPIPOLAR."""
    off = result.valid & (result.epipolar_distance > gate)
    rejection = np.where(off, Rejection.EPIPOLAR, result.rejection).astype(np.uint8)
    return replace(result, points=np.where(off[:, None], np.nan, result.points), rejection=rejection)


def keys(row: ArrayLike, col: ArrayLike) -> NDArray[np.int64]:
    """Return the keys (N,) of dots by their rows and columns (N,)."""
    return np.asarray(row, dtype=np.int64) * _STRIDE + np.asarray(col, dtype=np.int64)


def _find(sorted_keys: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where the wanted keys are among the sorted ones, -1 where they are not."""
    if len(sorted_keys) == 0:
        return np.full(wanted.shape, -1, dtype=np.int64)
    place = np.minimum(np.searchsorted(sorted_keys, wanted), len(sorted_keys) - 1)
    return np.where(sorted_keys[place] == wanted, place, -1)


def displacements(
    previous: PreviousCloud, camera: CameraModel, base_from_camera: ArrayLike, key: NDArray[np.int64], pixels: ArrayLike
) -> Array:
    """Return how far each dot (N, 2) [px] is from where the previous cloud predicts it; NaN where it predicts nothing.

    Args:
        previous: The previous cloud.
        camera: Camera model.
        base_from_camera: (4, 4) present pose of the camera [m].
        key: (N,) of the dots, see :func:`keys`.
        pixels: (N, 2) raw camera pixels.
    """
    out = np.full((len(key), 2), np.nan)
    place = _find(previous.key, key)
    seen = np.flatnonzero(place >= 0)
    in_camera = transforms.apply(transforms.inverse(np.asarray(base_from_camera)), previous.points[place[seen]])
    ahead = in_camera[:, 2] > 0
    seen, in_camera = seen[ahead], in_camera[ahead]
    if len(seen):
        out[seen] = np.asarray(pixels, dtype=np.float64)[seen] - camera.project(in_camera)
    return out


def jumped_alone(
    key: NDArray[np.int64], displacement: Array, options: CheckOptions | None = None
) -> tuple[NDArray[np.bool_], Array]:
    """Return which dots (N,) bool jumped alone, and how far (N,) [px] each is from what it may do.

    A dot may stay where it was, whatever moves around it, and it may move as `company` of the dots around it do. The
    gate follows the noise of this distance in the image.

    Args:
        key: (N,) of the dots.
        displacement: (N, 2) [px] as :func:`displacements` returns it.
        options: See there.
    """
    options = options or CheckOptions()
    distance = np.full(len(key), np.nan)
    known = np.flatnonzero(np.isfinite(displacement).all(-1))
    order = np.argsort(key)
    place = _find(key[order], key[known][:, None] + _AROUND)
    around = np.where((place >= 0)[:, :, None], displacement[order[place]], np.nan)
    apart = np.sort(np.linalg.norm(around - displacement[known][:, None], axis=-1), axis=1)  # NaN last
    alone = apart[:, options.company - 1]
    judged = np.isfinite(alone)
    if not judged.any():
        return np.zeros(len(key), dtype=np.bool_), distance
    who = known[judged]
    distance[who] = np.minimum(alone[judged], np.linalg.norm(displacement[who], axis=-1))
    gate = max(options.least_gate, options.sigmas * _NORMAL * float(np.median(distance[who])))
    return np.nan_to_num(distance) > gate, distance


def remember(
    previous: PreviousCloud, key: NDArray[np.int64], points: Array, stamp: int, options: CheckOptions | None = None
) -> PreviousCloud:
    """Return the cloud to hand back with the next image.

    The present points replace the previous ones of the same dots; points that are too old, or newer than the present
    image (the clock jumped back), are forgotten.

    Args:
        previous: The cloud so far.
        key: (N,) of the present dots, each once.
        points: (N, 3) in the base frame [m].
        stamp: Of the present image [ns].
        options: See there.
    """
    options = options or CheckOptions()
    age = stamp - previous.stamp
    kept = (age >= 0) & (age <= 1e9 * options.longest) & ~np.isin(previous.key, key)
    all_keys = np.concatenate([previous.key[kept], key])
    order = np.argsort(all_keys)
    return PreviousCloud(
        all_keys[order],
        np.concatenate([previous.points[kept], points])[order],
        np.concatenate([previous.stamp[kept], np.full(len(key), stamp, dtype=np.int64)])[order],
    )
