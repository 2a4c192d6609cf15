"""Camera calibration from views of a chessboard, the distortion model chosen by the error on views left out."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sl_calibration.board_bundle import (
    BundleError,
    BundleProblem,
    BundleResult,
    BundleState,
    OddViewError,
    solve,
    solve_with_noise,
    without_outliers,
)
from sl_calibration.chessboard import Board
from sl_calibration.intrinsics import CAMERA_PRIORS, MODELS, Parametrisation, Priors
from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]

MIN_VIEWS = 3
_FOLDS = 8
_BETTER = 0.99
_FEW_VIEWS_INFLATION = 3.0
_ODD_SHARE = 0.35
_ODD_LEAST = 1.0
_UNDETERMINED = 0.2
"""Standard deviation of the focal length, as a share of it, from which on it is not determined at all."""


@dataclass(frozen=True)
class CameraOptions:
    """How to calibrate.

    Attributes:
        model: One of MODELS or ``auto``: the one with the least error on views left out.
        priors: What is believed before any image.
    """

    model: str = "auto"
    priors: Priors = CAMERA_PRIORS


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """A calibrated camera.

    Attributes:
        camera: The model.
        parametrisation: How ``parameters`` become the camera.
        parameters: Their values and one sigma, by name.
        covariance: (S, S) of the parameters of ``parametrisation``.
        poses: (V, 4, 4) camera_from_board [m].
        residuals: (V, N, 2) observed minus predicted [px]; NaN: left out.
        left_out: (V,) RMS [px] of each view when it was left out of the calibration and its pose alone was fitted.
        candidates: For each model tried: its (training, left-out) RMS [px].
        rejected: Number of corners left out, over all views.
    """

    camera: CameraModel
    parametrisation: Parametrisation
    parameters: dict[str, dict[str, float]]
    covariance: Array
    poses: Array
    residuals: Array
    left_out: Array
    candidates: dict[str, tuple[float, float]]
    rejected: int

    @property
    def per_view(self) -> Array:
        """(V,) RMS of each view [px]."""
        return np.array([rms(view) for view in self.residuals])


def rms(residuals: Array) -> float:
    """Return the RMS length [px] of residual vectors (..., 2), NaN ignored."""
    squares = (residuals**2).sum(-1)
    return float(np.sqrt(np.nanmean(squares))) if np.isfinite(squares).any() else float("nan")


def root_mean_square(values: Array) -> float:
    """Return the RMS of numbers, NaN ignored; NaN when there are none."""
    return float(np.sqrt(np.nanmean(values**2))) if np.isfinite(values).any() else float("nan")


def calibrate_camera(
    corners: Array, board: Board, width: int, height: int, options: CameraOptions | None = None
) -> CameraCalibration:
    """Calibrate a camera.

    Args:
        corners: (V, N, 2) raw pixels of the board's corners in each view, in the order of ``board.points``; NaN where a
            corner was not seen.
        board: The chessboard.
        width: Image width [px].
        height: Image height [px].
        options: See CameraOptions.

    Raises:
        InvalidInputError: fewer than three views.
        BundleError: the views do not determine the camera; OddViewError: one of them does not fit the others.
    """
    options = options or CameraOptions()
    corners = np.asarray(corners, dtype=np.float64)
    if len(corners) < MIN_VIEWS:
        raise InvalidInputError(
            f"too few views: {len(corners)}, at least {MIN_VIEWS} are needed, better 10 with the board tilted"
            f" differently"
        )
    names = MODELS if options.model == "auto" else (options.model,)
    kept, starts = corners, {}
    for name in MODELS if options.model in ("auto", "none", "pers_tied") else (options.model,):
        starts[name] = fit_camera(corners, board, Parametrisation(name, width, height), options.priors)
    flexible = min(starts, key=lambda name: rms(starts[name][1].residuals))
    kept = without_outliers(*starts[flexible]).observed
    fits = {}
    for name in names:
        parametrisation = Parametrisation(name, width, height)
        fits[name] = fit_camera(kept, board, parametrisation, options.priors, starts[name][1].state)
    tests = {name: _leave_out(board, *fits[name], Parametrisation(name, width, height)) for name in names}
    scores = {name: root_mean_square(tests[name][0]) for name in names}
    chosen = names[0]
    for name in names[1:]:
        if scores[name] < _BETTER * scores[chosen] or not np.isfinite(scores[chosen]):
            chosen = name
    result = fits[chosen][1]
    parametrisation = Parametrisation(chosen, width, height)
    covariance = honest_covariance(result, tests[chosen][1])
    summary = parametrisation.summary(result.state.shared, np.sqrt(np.diag(covariance)))
    _require_determined(summary)
    return CameraCalibration(
        parametrisation.camera(result.state.shared),
        parametrisation,
        summary,
        covariance,
        result.state.poses,
        result.residuals,
        tests[chosen][0],
        {name: (rms(fits[name][1].residuals), scores[name]) for name in names},
        int(np.isfinite(corners).all(-1).sum() - np.isfinite(kept).all(-1).sum()),
    )


def same_views(corners: Array, least: float = 1.0) -> dict[int, int]:
    """Return the views that show the board where an earlier one does: {view: earlier view}.

    They tell nothing new, but would count as if they did: an image given twice has the same errors twice.

    Args:
        corners: (V, N, 2) [px].
        least: RMS distance of the corners from which on views are different [px].
    """
    twins: dict[int, int] = {}
    for k, view in enumerate(corners):
        for earlier in range(k):
            if earlier not in twins and rms(view - corners[earlier]) < least:
                twins[k] = earlier
                break
    return twins


def _require_determined(summary: dict[str, dict[str, float]]) -> None:
    """Raise BundleError where the views leave the focal length open."""
    value, sigma = summary["fx"]["value"], summary["fx"]["sigma"]
    if not sigma < _UNDETERMINED * value:
        raise BundleError(
            f"the views do not determine the camera: focal length {value:.0f} +- {1.96 * sigma:.0f} px (95 %);"
            " tilt the board by 30 deg and more, about both of its axes, differently in each view"
        )


@contextmanager
def name_odd_view(names: Sequence[str]) -> Iterator[None]:
    """Turn an OddViewError into an InvalidInputError that calls the view by its name."""
    try:
        yield
    except OddViewError as error:
        raise InvalidInputError(
            f"{names[error.view]} does not fit the others: {error.reason}. Another camera, board or zoom, camera or"
            " projector moved, or images of two captures mixed? Leave it out"
        ) from None


def fit_camera(
    corners: Array, board: Board, parametrisation: Parametrisation, priors: Priors, start: BundleState | None = None
) -> tuple[BundleProblem, BundleResult]:
    """Fit one model to corners (V, N, 2) [px], from a start or from none. Raises BundleError."""
    mean, sigma = parametrisation.prior(priors)
    problem = BundleProblem(
        lambda shared, points: parametrisation.camera(shared).project(points),
        board.points,
        corners,
        np.ones(2),
        parametrisation.steps,
        mean,
        sigma,
    )
    start = start or _best_start(problem, board, parametrisation)
    return solve_with_noise(problem, start, channels=(slice(0, 2),))


def view_pose(corners: Array, points: Array, camera: CameraModel) -> Array:
    """Return camera_from_board (4, 4) [m] that minimises the reprojection of points (N, 3) of a plane to pixels (N, 2).

    Raises BundleError where no pose in front of the camera is found.
    """
    best, least = None, np.inf
    empty = np.zeros(0)
    problem = BundleProblem(
        lambda _, in_camera: camera.project(in_camera), points, corners[None], np.ones(2), empty, empty, empty
    )
    for start in _planar_poses(corners, points, camera):
        try:
            result = solve(problem, BundleState(empty, start[None]), max_iterations=30)
        except BundleError:
            continue
        if result.cost < least:
            best, least = result.state.poses[0], result.cost
    if best is None:
        raise BundleError("no pose of the board in front of the camera explains its corners")
    return best


def honest_covariance(result: BundleResult, replicates: Array) -> Array:
    """Widen the covariance of the shared parameters to what views left out show.

    The residuals of one view are correlated (a bent board, an imperfect lens model), so the posterior is too sure of
    itself. Each standard deviation becomes at least the delete-a-group jackknife's, and never less than three times the
    posterior's over the square root of the number of views less one.

    Args:
        result: The solution, its first S unknowns the shared parameters.
        replicates: (K, S) shared parameters of the fits with a group of views left out; NaN: not solved.

    Returns:
        (S, S) covariance.
    """
    width = len(result.state.shared)
    covariance = result.covariance[:width, :width]
    posterior = np.sqrt(np.diag(covariance))
    views = len(result.state.poses)
    factor = np.full(width, max(1.0, _FEW_VIEWS_INFLATION / np.sqrt(max(views - 1, 1))))
    solved = replicates[np.isfinite(replicates).all(-1)]
    groups = len(solved)
    if groups >= 3:
        jackknife = np.sqrt((groups - 1) / groups * ((solved - solved.mean(0)) ** 2).sum(0))
        factor = np.maximum(factor, jackknife / posterior)
    return covariance * np.outer(factor, factor)


def leave_views_out(
    problem: BundleProblem, result: BundleResult, score: Callable[[BundleState, int], float]
) -> tuple[Array, Array]:
    """Fit with groups of views left out, at most eight groups.

    Args:
        problem: The problem with all views.
        result: Its solution, the start of every fit.
        score: (state without view k, k) -> error of view k.

    Returns:
        Errors (V,), NaN where a fit failed, and the shared parameters (K, S) of each fit.

    Raises:
        OddViewError: without one view the rest fits far better than with it.
    """
    views = len(problem.observed)
    overall = root_mean_square(result.residuals) * np.sqrt(2)
    errors = np.full(views, np.nan)
    folds = np.arange(views) % min(views, _FOLDS)
    replicates = np.full((folds.max() + 1, len(result.state.shared)), np.nan)
    for fold in range(len(replicates)):
        train = folds != fold
        try:
            trained = solve(problem.of_views(train), BundleState(result.state.shared, result.state.poses[train]))
            state = trained.state
            replicates[fold] = state.shared
            rest = root_mean_square(trained.residuals) * np.sqrt(2)
            if views > MIN_VIEWS and (~train).sum() == 1 and overall > _ODD_LEAST and rest < _ODD_SHARE * overall:
                raise OddViewError(fold, f"without it the others' error falls from {overall:.2f} to {rest:.2f} px")
            for k in np.flatnonzero(~train):
                errors[k] = score(state, int(k))
        except OddViewError:
            raise
        except BundleError:
            continue
    return errors, replicates


def _leave_out(
    board: Board, problem: BundleProblem, result: BundleResult, parametrisation: Parametrisation
) -> tuple[Array, Array]:
    def score(state: BundleState, view: int) -> float:
        camera = parametrisation.camera(state.shared)
        corners = problem.observed[view]
        pose = view_pose(corners, board.points, camera)
        return rms(corners - camera.project(transforms.apply(pose, board.points)))

    return leave_views_out(problem, result, score)


def _planar_poses(corners: Array, points: Array, camera: CameraModel) -> list[Array]:
    """Both poses (4, 4) that a plane seen in weak perspective admits, in front of the camera, the likelier first."""
    with np.errstate(all="ignore"):
        ideal = camera.undistort(corners)
    ideal = np.where(np.isfinite(ideal), ideal, camera.to_normalised(corners))
    seen = np.isfinite(ideal).all(-1)
    centre = points.mean(0)
    _, rotations, translations, _ = cv2.solvePnPGeneric(
        points[seen] - centre, ideal[seen], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    poses = []
    for rotation, translation in zip(rotations, translations, strict=True):
        pose = transforms.make(cv2.Rodrigues(rotation)[0], translation.ravel())
        pose[:3, 3] -= pose[:3, :3] @ centre
        if (transforms.apply(pose, points)[:, 2] > 0).all():
            poses.append(pose)
    return poses


def _best_start(problem: BundleProblem, board: Board, parametrisation: Parametrisation) -> BundleState:
    """Try focal lengths from fish-eye to telescope and keep the best after a short adjustment."""
    best, least = None, np.inf
    middle = (parametrisation.width - 1) / 2, (parametrisation.height - 1) / 2
    for focal in _focal_guesses(problem.observed, board, parametrisation):
        matrix = np.array([[focal, 0, middle[0]], [0, focal, middle[1]], [0, 0, 1]])
        state = _start_at(problem.observed, board, parametrisation, parametrisation.start(matrix))
        for _ in range(2):  # the second time with both solutions of each pose at the better focal length
            if state is None:
                break
            try:
                result = solve(problem, state, max_iterations=15)
            except BundleError:
                break
            if result.cost < least:
                best, least = result.state, result.cost
            state = _start_at(problem.observed, board, parametrisation, result.state.shared)
    if best is None:
        raise BundleError("no focal length explains the views; are they all of the same camera and the same board?")
    return best


def _start_at(corners: Array, board: Board, parametrisation: Parametrisation, shared: Array) -> BundleState | None:
    camera = parametrisation.camera(shared)
    poses = []
    for view in corners:
        candidates = _planar_poses(view, board.points, camera)
        if not candidates:
            return None
        poses.append(candidates[0])
    return BundleState(shared, np.array(poses))


def _focal_guesses(corners: Array, board: Board, parametrisation: Parametrisation) -> list[float]:
    guesses = [factor * parametrisation.width for factor in (0.4, 1.0, 2.5)]
    complete = [view for view in corners if np.isfinite(view).all()]
    if complete:
        points = [board.points.astype(np.float32)] * len(complete)
        pixels = [view.astype(np.float32) for view in complete]
        matrix = cv2.initCameraMatrix2D(points, pixels, (parametrisation.width, parametrisation.height))
        if np.isfinite(matrix).all() and 0.2 < matrix[0, 0] / parametrisation.width < 20:
            guesses.insert(0, float(matrix[0, 0]))
    return guesses
