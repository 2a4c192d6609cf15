"""Joint calibration of a camera and a projector from a board's corners in both (section III.B).

One adjustment over all views: intrinsics of both, one pose of the projector in the camera's frame, one of the board in
each view. It starts from the camera alone, from whose board poses the projector's matrix follows linearly, whatever its
lens shift, and from virtual screens; the best start wins.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import rq

from sl_calibration.board_bundle import (
    BundleError,
    BundleProblem,
    BundleResult,
    BundleState,
    solve,
    solve_with_noise,
    without_outliers,
)
from sl_calibration.camera_calibration import fit_camera, honest_covariance, leave_views_out, rms, view_pose
from sl_calibration.chessboard import Board
from sl_calibration.intrinsics import CAMERA_PRIORS, PROJECTOR_PRIORS, Parametrisation, Priors
from sl_calibration.triangulation import TriangulationOptions, triangulate
from sl_calibration.virtual_screen import starting_centers
from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]

MIN_VIEWS = 2
_GOOD_START = 0.5
"""Median residual [px] at which a start is good enough not to try another."""


@dataclass(frozen=True)
class ProcamOptions:
    """How to calibrate camera and projector.

    Attributes:
        camera_model: Distortion model of the camera, one of intrinsics.MODELS.
        projector_model: Distortion model of the projector.
        camera_priors: What is believed of the camera before any image.
        projector_priors: What is believed of the projector.
        start: A guess of the projector to try beside the ones made from the data; never needed.
    """

    camera_model: str = "plumb_bob"
    projector_model: str = "plumb_bob"
    camera_priors: Priors = CAMERA_PRIORS
    projector_priors: Priors = PROJECTOR_PRIORS
    start: CameraModel | None = None


@dataclass(frozen=True, eq=False)
class ProcamCalibration:
    """A calibrated camera-projector pair.

    Attributes:
        camera: The camera.
        projector: The projector.
        camera_from_projector: (4, 4) [m].
        pose_covariance: (6, 6) of camera_from_projector (x y z rx ry rz).
        camera_parameters: Value and one sigma of each parameter of the camera, by name.
        projector_parameters: The same of the projector.
        poses: (V, 4, 4) camera_from_board [m].
        camera_residuals: (V, N, 2) observed minus predicted [px]; NaN: left out.
        projector_residuals: (V, N, 2) likewise in the projector.
        left_out_camera: (V,) RMS [px] of each view when it was left out: its pose fitted to the camera's corners.
        left_out_projector: (V,) RMS [px] of the projector's corners predicted from that pose.
        rigid_fit: (V,) RMS distance [mm] of the triangulated corners from the board, moved rigidly.
    """

    camera: CameraModel
    projector: CameraModel
    camera_from_projector: Array
    pose_covariance: Array
    camera_parameters: dict[str, dict[str, float]]
    projector_parameters: dict[str, dict[str, float]]
    poses: Array
    camera_residuals: Array
    projector_residuals: Array
    left_out_camera: Array
    left_out_projector: Array
    rigid_fit: Array

    @property
    def joint_rms(self) -> float:
        """RMS over both sensors [px]."""
        return rms(np.concatenate([self.camera_residuals, self.projector_residuals], axis=1))

    @property
    def rejected(self) -> int:
        """Corners left out, over all views."""
        return int(np.isnan(self.camera_residuals[..., 0]).sum())


@dataclass(frozen=True, eq=False)
class _Pair:
    """The parameters of both sensors in one vector: camera, projector, perturbation of a nominal extrinsic pose."""

    camera: Parametrisation
    projector: Parametrisation
    nominal: Array

    def split(self, shared: Array) -> tuple[CameraModel, CameraModel, Array]:
        """Return camera, projector and projector_from_camera (4, 4)."""
        at = self.camera.size
        end = at + self.projector.size
        return (
            self.camera.camera(shared[:at]),
            self.projector.camera(shared[at:end]),
            transforms.perturb(self.nominal, shared[end:]),
        )

    def predict(self, shared: Array, points: Array) -> Array:
        """Predict (V, N, 4): camera and projector pixels of points (V, N, 3) in the camera's frame."""
        camera, projector, projector_from_camera = self.split(shared)
        seen = projector.project(transforms.apply(projector_from_camera, points))
        return np.concatenate([camera.project(points), seen], axis=-1)


def calibrate_procam(
    camera_corners: Array,
    projector_corners: Array,
    board: Board,
    camera_size: tuple[int, int],
    projector_size: tuple[int, int],
    options: ProcamOptions | None = None,
) -> ProcamCalibration:
    """Calibrate a camera and a projector together.

    Args:
        camera_corners: (V, N, 2) raw camera pixels of the board's corners; NaN where not seen.
        projector_corners: (V, N, 2) projector pixels of the same corners; NaN where not decoded.
        board: The chessboard.
        camera_size: (width, height) of the camera image [px].
        projector_size: (width, height) of the projector's panel [px].
        options: See ProcamOptions.

    Raises:
        InvalidInputError: fewer than two views.
        BundleError: the views do not determine the pair.
    """
    options = options or ProcamOptions()
    observed = np.concatenate([camera_corners, projector_corners], axis=-1).astype(np.float64)
    observed[~np.isfinite(observed).all(-1)] = np.nan
    if len(observed) < MIN_VIEWS:
        raise InvalidInputError(
            f"too few views: {len(observed)} capture of the board, at least {MIN_VIEWS} with the board tilted"
            f" differently"
            " are needed, better 5"
        )
    camera = Parametrisation(options.camera_model, *camera_size)
    projector = Parametrisation(options.projector_model, *projector_size)
    _, alone = fit_camera(observed[..., :2], board, camera, options.camera_priors)
    problem, start, pair = _best_start(observed, board, camera, projector, options, alone.state)
    channels = (slice(0, 2), slice(2, 4))
    for _ in range(3):
        problem, result = solve_with_noise(problem, start, channels=channels)
        cleaned = without_outliers(problem, result)
        same = np.isfinite(cleaned.observed).sum() == np.isfinite(problem.observed).sum()
        start, problem = result.state, cleaned
        if same:
            break
    else:
        problem, result = solve_with_noise(problem, start, channels=channels)
    return _report(problem, result, board, pair)


def _report(problem: BundleProblem, result: BundleResult, board: Board, pair: _Pair) -> ProcamCalibration:
    camera, projector, projector_from_camera = pair.split(result.state.shared)
    errors_in_camera = np.full(len(problem.observed), np.nan)

    def score(state: BundleState, view: int) -> float:
        own_camera, own_projector, extrinsics = pair.split(state.shared)
        seen = problem.observed[view]
        pose = view_pose(seen[:, :2], board.points, own_camera)
        points = transforms.apply(pose, board.points)
        errors_in_camera[view] = rms(seen[:, :2] - own_camera.project(points))
        return rms(seen[:, 2:] - own_projector.project(transforms.apply(extrinsics, points)))

    left_out, replicates = leave_views_out(problem, result, score)
    covariance = honest_covariance(result, replicates)
    sigma = np.sqrt(np.diag(covariance))
    at, end = pair.camera.size, pair.camera.size + pair.projector.size
    camera_from_projector = transforms.inverse(projector_from_camera)
    turn = np.zeros((6, 6))  # of the inverse pose: t' = -R^T t, each perturbation seen from the other frame
    rotation = camera_from_projector[:3, :3]
    turn[:3, :3] = -rotation
    turn[:3, 3:] = -rotation @ transforms.skew(projector_from_camera[:3, 3])
    turn[3:, 3:] = -rotation
    rigid = [rigid_fit(view, camera, projector, camera_from_projector, board) for view in problem.observed]
    return ProcamCalibration(
        camera,
        projector,
        camera_from_projector,
        turn @ covariance[end:, end:] @ turn.T,
        pair.camera.summary(result.state.shared[:at], sigma[:at]),
        pair.projector.summary(result.state.shared[at:end], sigma[at:end]),
        result.state.poses,
        result.residuals[..., :2],
        result.residuals[..., 2:],
        errors_in_camera,
        left_out,
        np.array(rigid),
    )


def rigid_fit(
    observed: Array, camera: CameraModel, projector: CameraModel, camera_from_projector: Array, board: Board
) -> float:
    """Triangulate a view's corners (N, 4: camera and projector px) and return their RMS distance [mm] from the
    board."""
    options = TriangulationOptions(max_epipolar_distance=np.inf, projector_sigma=0.5, camera_sigma=0.5)
    seen = np.isfinite(observed).all(-1)
    found = triangulate(camera, projector, camera_from_projector, observed[seen, :2], observed[seen, 2:], options)
    good = np.isfinite(found.points).all(-1)
    if good.sum() < 4:
        return float("nan")
    measured, nominal = found.points[good], board.points[seen][good]
    left, right = measured - measured.mean(0), nominal - nominal.mean(0)
    u, _, vt = np.linalg.svd(left.T @ right)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return float(1e3 * np.sqrt(((left - right @ rotation.T) ** 2).sum(-1).mean()))


def _best_start(
    observed: Array,
    board: Board,
    camera: Parametrisation,
    projector: Parametrisation,
    options: ProcamOptions,
    alone: BundleState,
) -> tuple[BundleProblem, BundleState, _Pair]:
    points = transforms.apply(alone.poses, board.points)
    seen = np.isfinite(observed).all(-1)
    means = [
        prior.prior(given) for prior, given in ((camera, options.camera_priors), (projector, options.projector_priors))
    ]
    best: tuple[BundleProblem, BundleState, _Pair] | None = None
    least = np.inf
    for matrix, projector_from_camera in _projector_starts(points[seen], observed[seen, 2:], projector, options.start):
        pair = _Pair(camera, projector, projector_from_camera)
        problem = BundleProblem(
            pair.predict,
            board.points,
            observed,
            np.full(4, 0.3),
            np.concatenate([camera.steps, projector.steps, np.full(6, 1e-6)]),
            np.concatenate([means[0][0], means[1][0], np.zeros(6)]),
            np.concatenate([means[0][1], means[1][1], np.full(6, np.inf)]),
        )
        state = BundleState(np.concatenate([alone.shared, projector.start(matrix), np.zeros(6)]), alone.poses)
        try:
            result = solve(problem, state, max_iterations=12)
        except BundleError:
            continue
        if result.cost < 0.99 * least:
            best, least = (problem, result.state, pair), result.cost
        if np.nanmedian(np.abs(result.residuals)) < _GOOD_START:
            break
    if best is None:
        raise BundleError(
            "no projector explains the decoded corners: are camera and projector corners of the same views?"
        )
    return best


def _projector_starts(
    points: Array, pixels: Array, projector: Parametrisation, guess: CameraModel | None
) -> list[tuple[Array, Array]]:
    """Return (matrix (3, 3), projector_from_camera (4, 4)) to start from: linear, from virtual screens, from the
    guess."""
    starts = []
    linear = _linear_projector(points, pixels)
    if linear is not None and _plausible(linear[0], projector):
        starts.append(linear)
    matrices = [guess.matrix] if guess is not None else []
    for cx, cy in starting_centers(projector.width, projector.height):
        focal = 1.7 * projector.width
        matrices.append(np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1.0]]))
    for matrix in matrices:
        pose = _pose_of_points(points, pixels, matrix)
        if pose is not None:
            starts.append((matrix, pose))
    return starts


def _plausible(matrix: Array, projector: Parametrisation) -> bool:
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    width, height = projector.width, projector.height
    return bool(
        0.2 < fx / width < 20
        and 0.5 < fy / fx < 2
        and abs(cx - width / 2) < 2 * width
        and abs(cy - height / 2) < 3 * height
    )


def _linear_projector(points: Array, pixels: Array) -> tuple[Array, Array] | None:
    """Resection of a projector from points (K, 3), not all in one plane, by the direct linear transform."""
    centre, spread = points.mean(0), points.std()
    middle, width = pixels.mean(0), pixels.std()
    p = np.concatenate([(points - centre) / spread, np.ones((len(points), 1))], axis=-1)
    x = (pixels - middle) / width
    zero = np.zeros_like(p)
    rows = np.concatenate(
        [np.concatenate([p, zero, -x[:, :1] * p], axis=-1), np.concatenate([zero, p, -x[:, 1:] * p], axis=-1)]
    )
    _, values, vt = np.linalg.svd(rows, full_matrices=False)
    if values[-2] < 1e-9 * values[0]:
        return None
    matrix = np.array([[width, 0, middle[0]], [0, width, middle[1]], [0, 0, 1]]) @ vt[-1].reshape(3, 4)
    matrix = matrix @ np.block([[np.eye(3) / spread, -centre[:, None] / spread], [np.zeros((1, 3)), np.ones((1, 1))]])
    if np.linalg.det(matrix[:, :3]) < 0:
        matrix = -matrix
    intrinsic, rotation = rq(matrix[:, :3])
    signs = np.diag(np.sign(np.diag(intrinsic)))
    intrinsic, rotation = intrinsic @ signs, signs @ rotation
    translation = np.linalg.solve(intrinsic, matrix[:, 3])
    intrinsic = intrinsic / intrinsic[2, 2]
    intrinsic[0, 1] = 0.0
    pose = transforms.make(rotation, translation)
    return (intrinsic, pose) if (transforms.apply(pose, points)[:, 2] > 0).all() else None


def _pose_of_points(points: Array, pixels: Array, matrix: Array) -> Array | None:
    """projector_from_camera (4, 4) of points seen under an assumed matrix; None where none is in front."""
    ok, rotation, translation = cv2.solvePnP(points, pixels, matrix, None, flags=cv2.SOLVEPNP_SQPNP)
    if not ok:
        return None
    pose = transforms.make(cv2.Rodrigues(rotation)[0], translation.ravel())
    return pose if (transforms.apply(pose, points)[:, 2] > 0).all() else None
