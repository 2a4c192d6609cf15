"""Drive values of the letters, such that the camera tells them apart best (section III.B).

The least distance between any two letters of one shape in the camera's colour space is made as great as it gets,
without saturating the camera and without letters too dark to be found. Distance along the common brightness counts
less than distance in colour: a darker surface dims a letter, but does not change its hue.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from sl_calibration.colour_response import ColourModel
from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]

_GRID = np.linspace(0, 255, 7)
_STEPS = (48, 24, 12, 6, 3, 1)


@dataclass(frozen=True)
class LetterOptions:
    """What letters may look like.

    Attributes:
        ceiling: Largest camera value above black of any channel, on the brightest surface considered.
        floor: Least value of a letter's brightest channel, as a share of the brightest letter's.
        intensity_weight: Weight of distance along the common brightness, against distance in colour.
        seed: Of the search.
        restarts: Number of searches.
    """

    ceiling: float = 235.0
    floor: float = 0.35
    intensity_weight: float = 0.5
    seed: int = 0
    restarts: int = 8


def least_distance(camera: Array, shapes: tuple[str, ...], weight: float = 1.0) -> float:
    """Return the least distance [grey levels] between two letters of the same shape, of camera values (A, 3)."""
    return float(_distances(camera, shapes, weight).min())


def choose_letters(
    model: ColourModel,
    shapes: tuple[str, ...],
    options: LetterOptions | None = None,
    *,
    albedos: Array | None = None,
    like: Array | None = None,
) -> NDArray[np.uint8]:
    """Choose drive values.

    Args:
        model: The fitted response.
        shapes: Shape of each of the A letters; letters of different shapes need not differ in colour.
        options: See LetterOptions.
        albedos: (K, 3) factors on the camera values of surfaces that the scene has (Caspi's adaptation); None: one
        surface. like: (A, 3) camera values of the letters before; the new colours are dealt out so that each stays
        near its own.

    Returns:
        (A, 3) uint8 drive values, R G B.

    Raises:
        InvalidInputError: no drive values are bright enough without saturation.
    """
    options = options or LetterOptions()
    surfaces = np.ones((1, 3)) if albedos is None else np.asarray(albedos, dtype=np.float64)
    candidates = np.stack(np.meshgrid(_GRID, _GRID, _GRID, indexing="ij"), axis=-1).reshape(-1, 3)
    brightest = _brightest(model, candidates, surfaces, options)
    candidates = candidates[_allowed(model, candidates, surfaces, options, brightest)]
    letters = len(shapes)
    if len(candidates) < letters:
        raise InvalidInputError(
            f"only {len(candidates)} colours are visible without saturating the camera, {letters} letters need as many:"
            " lower the exposure"
        )
    rng = np.random.default_rng(options.seed)
    best, score = None, -1.0
    for _ in range(options.restarts):
        drives = _spread(model, candidates, shapes, surfaces, options, rng)
        drives = _climb(model, drives, shapes, surfaces, options, brightest)
        own = _score(model, drives, shapes, surfaces, options)
        if own > score:
            best, score = drives, own
    assert best is not None
    chosen = np.round(best)
    if like is not None:
        chosen = _dealt(model, chosen, shapes, like)
    return chosen.astype(np.uint8)


@cache
def _pairs(shapes: tuple[str, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices (P,), (P,) of letters of the same shape."""
    i, j = np.triu_indices(len(shapes), 1)
    same = np.array([shapes[a] == shapes[b] for a, b in zip(i, j, strict=True)], dtype=bool)
    return i[same], j[same]


def _distances(camera: Array, shapes: tuple[str, ...], weight: float) -> Array:
    """Upper triangle (P,) of weighted distances of camera values (..., A, 3), least over the leading dimensions."""
    camera = np.asarray(camera, dtype=np.float64)
    i, j = _pairs(shapes)
    if not len(i):
        return np.array([np.inf])
    difference = camera[..., i, :] - camera[..., j, :]
    common = camera[..., i, :] + camera[..., j, :]
    common = common / np.maximum(np.linalg.norm(common, axis=-1, keepdims=True), 1e-9)
    along = (difference * common).sum(-1)
    across = np.maximum((difference**2).sum(-1) - along**2, 0.0)
    distance = np.sqrt(across + (weight * along) ** 2)
    return distance.reshape(-1, len(i)).min(axis=0)


def _score(
    model: ColourModel, drives: Array, shapes: tuple[str, ...], surfaces: Array, options: LetterOptions
) -> float:
    camera = model.camera(drives) * surfaces[:, None, :]
    scale = np.maximum(surfaces.max(axis=1), 1e-6)[
        :, None, None
    ]  # a dark surface must not decide by its darkness alone
    return float(_distances(camera / scale, shapes, options.intensity_weight).min())


def _brightest(model: ColourModel, candidates: Array, surfaces: Array, options: LetterOptions) -> float:
    values = model.camera(candidates)
    fits = (values * surfaces.max(axis=0)).max(axis=-1) <= options.ceiling
    return float(values[fits].max()) if fits.any() else 0.0


def _allowed(
    model: ColourModel, drives: Array, surfaces: Array, options: LetterOptions, brightest: float
) -> NDArray[np.bool_]:
    values = model.camera(drives)
    top = (values * surfaces.max(axis=0)).max(axis=-1)
    return (top <= options.ceiling) & (values.max(axis=-1) >= options.floor * brightest) & (drives.max(axis=-1) > 0)


def _spread(
    model: ColourModel,
    candidates: Array,
    shapes: tuple[str, ...],
    surfaces: Array,
    options: LetterOptions,
    rng: np.random.Generator,
) -> Array:
    """Farthest-point start for each shape, from a random first colour."""
    drives = np.zeros((len(shapes), 3))
    for shape in dict.fromkeys(shapes):
        places = [k for k, own in enumerate(shapes) if own == shape]
        chosen = [int(rng.integers(len(candidates)))]
        while len(chosen) < len(places):
            camera = model.camera(candidates)[None] * surfaces[:, None, :]
            least = np.full(len(candidates), np.inf)
            for picked in chosen:
                difference = camera - camera[:, picked : picked + 1]
                common = camera + camera[:, picked : picked + 1]
                common = common / np.maximum(np.linalg.norm(common, axis=-1, keepdims=True), 1e-9)
                along = (difference * common).sum(-1)
                across = (difference**2).sum(-1) - along**2
                distance = np.sqrt(np.maximum(across, 0) + (options.intensity_weight * along) ** 2).min(axis=0)
                least = np.minimum(least, distance)
            chosen.append(int(np.argmax(least)))
        drives[places] = candidates[chosen]
    return drives


def _climb(
    model: ColourModel,
    drives: Array,
    shapes: tuple[str, ...],
    surfaces: Array,
    options: LetterOptions,
    brightest: float,
) -> Array:
    """Move one letter at a time along one or two channels while the least distance grows, with ever smaller steps."""
    moves = np.array([m for m in np.ndindex(3, 3, 3) if m != (1, 1, 1)]) - 1
    score = _score(model, drives, shapes, surfaces, options)
    for step in _STEPS:
        improved = True
        while improved:
            improved = False
            for letter in range(len(drives)):
                for move in moves:
                    trial = drives.copy()
                    trial[letter] = np.clip(trial[letter] + step * move, 0, 255)
                    if not _allowed(model, trial[letter : letter + 1], surfaces, options, brightest)[0]:
                        continue
                    own = _score(model, trial, shapes, surfaces, options)
                    if own > score + 1e-6:
                        drives, score, improved = trial, own, True
    return drives


def _dealt(model: ColourModel, drives: Array, shapes: tuple[str, ...], like: Array) -> Array:
    """Deal the colours of each shape out so that each letter's is near, in direction, to what it was."""
    camera = model.camera(drives)
    unit = camera / np.maximum(np.linalg.norm(camera, axis=-1, keepdims=True), 1e-9)
    before = like / np.maximum(np.linalg.norm(like, axis=-1, keepdims=True), 1e-9)
    out = drives.copy()
    for shape in dict.fromkeys(shapes):
        places = np.array([k for k, own in enumerate(shapes) if own == shape])
        cost = np.linalg.norm(before[places][:, None] - unit[places][None], axis=-1)
        rows, columns = linear_sum_assignment(cost)
        out[places[rows]] = drives[places[columns]]
    return out
