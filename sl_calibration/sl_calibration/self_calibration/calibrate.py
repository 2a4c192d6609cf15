"""Self-calibration from known robot motion: projector, hand-eye transform and dots with their uncertainties."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration import centroids, consistency, lens
from sl_calibration.self_calibration.bundle_adjustment import adjust, consider, covariance, normal_equations
from sl_calibration.self_calibration.bundle_problem import Noise, Problem, State, linearise
from sl_calibration.self_calibration.determinacy import check_determined
from sl_calibration.self_calibration.errors import InconsistentPosesError, SelfCalibrationError, TooFewViewsError
from sl_calibration.self_calibration.initialise import resect_projector, translation_and_points
from sl_calibration.self_calibration.left_out import left_out_errors
from sl_calibration.self_calibration.noise_model import RobotNoise, estimate, inflate
from sl_calibration.self_calibration.outliers import (
    complete_points,
    drop_dots,
    drop_views,
    heavy_tails,
    outlier_pose,
    reinstate,
    reprojection_errors,
    right_observations,
)
from sl_calibration.self_calibration.relative_motion import pair_rotations
from sl_calibration.self_calibration.result import LeftOut, SelfCalibration
from sl_calibration.self_calibration.views import LEAST_DOTS, Observations, View, check_poses, flatten
from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]
Progress = Callable[[str], None]

HEAVY_TAILS = 0.005
"""Share of errors between four and ten standard deviations from which on they are not normal; normal ones: 0.0003."""

_ROUNDS = 5

SIGNIFICANT = 3.0
"""Standard deviations by which the projector's distortion must differ from zero to be kept."""


@dataclass(frozen=True, kw_only=True)
class SelfCalibrationOptions:
    """How to calibrate.

    Attributes:
        robot: Noise of the reported flange poses.
        refine_camera: Estimate the camera's intrinsics too.
        projector_distortion: Look for radial distortion of the projector and keep it where it is significant.
        left_out: Estimate the errors of views left out, at the price of a few more adjustments.
        spot_diameter: Of the dots [projector px]; given, the displacement of their centroids is modelled.
    """

    robot: RobotNoise = field(default_factory=RobotNoise)
    refine_camera: bool = False
    projector_distortion: bool = True
    left_out: bool = True
    spot_diameter: float | None = None


def self_calibrate(
    views: Sequence[View],
    camera: CameraModel,
    centers: Array,
    projector_size: tuple[int, int],
    options: SelfCalibrationOptions | None = None,
    progress: Progress = lambda _: None,
) -> SelfCalibration:
    """Calibrate projector and hand-eye transform from views of a static scene under a static projector.

    No initial guess is needed. The gauge is the robot's: reported flange poses enter as a prior with their noise.

    Args:
        views: At least three, of which the flange turns about two axes.
        camera: Camera model.
        centers: (rows, cols, 2) spot centres of the pattern [projector px].
        projector_size: Width and height of the projector image [px].
        options: See :class:`SelfCalibrationOptions`.
        progress: Called with the name of each stage.

    Raises:
        SelfCalibrationError: The subclass says which condition, the message what to do next.
        InvalidInputError: Dots outside the pattern or image, poses that are not rigid or in millimetres.
    """
    options = options or SelfCalibrationOptions()
    sparse = [v.name for v in views if len(v.row) < LEAST_DOTS]
    views = [v for v in views if len(v.row) >= LEAST_DOTS]
    check_poses([v.name for v in views], np.array([v.base_from_flange for v in views]).reshape(-1, 4, 4))
    consistency.check_motion(np.array([v.base_from_flange for v in views]).reshape(-1, 4, 4))
    observations = flatten(views, centers)
    _check_pixels(observations, camera)

    progress("camera rotations")
    focal = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
    normalised = camera.undistort(observations.pixels)
    invertible = np.asarray(np.isfinite(normalised).all(-1))
    total = len(observations.view)
    observations, normalised = observations.select(invertible), normalised[invertible]
    pairs = pair_rotations(observations, normalised, focal)
    rotation, good = consistency.check_pairs(pairs, observations.names)
    if not good.all():
        good = _reinstated(observations, normalised, focal, rotation, good)
        consistency.check_most(pairs, observations.names, good)
    warnings = [f"left out: {name} has fewer than {LEAST_DOTS} dots" for name in sparse]
    warnings += [f"left out: {s}" for s in consistency.describe_outliers(pairs, observations.names, good)]
    observations, normalised = drop_views(observations, good, normalised)
    consistency.check_motion(observations.base_from_flange)

    progress("hand-eye and dots")
    linear = translation_and_points(observations, normalised, focal, rotation)
    right = right_observations(observations.view, linear.error, len(observations.names))
    found = np.isfinite(linear.points).all(-1) & (
        np.bincount(observations.point[right], minlength=len(linear.points)) > 1
    )
    progress("projector")
    matrix, pose = resect_projector(linear.points[found], observations.projector_pixels[found], projector_size)
    projector = CameraModel(*projector_size, matrix)

    points = complete_points(observations, linear, found, camera, projector, pose)
    observations, points = drop_dots(observations, np.asarray(np.isfinite(points).all(-1)), points)
    state = State(
        linear.flange_from_camera,
        pose,
        lens.parameters(projector),
        lens.parameters(camera),
        observations.base_from_flange.copy(),
        points,
    )
    problem = Problem(
        observations,
        camera,
        projector,
        _free_camera(camera, options.refine_camera),
        np.ones(4, dtype=bool),
        Noise(
            np.full(len(observations.names), 0.3),
            projector=0.1,
            position=options.robot.position,
            rotation=options.robot.rotation,
        ),
        huber=2.5,
    )
    problem, state = _reject(problem, state, first=True)
    progress("bundle adjustment")
    if options.projector_distortion:
        problem, state = _with_distortion(problem, state)
    problem, state, tails = _robust(problem, state, warnings)
    if options.spot_diameter:
        problem, state = _start_centroids(problem, state, options.spot_diameter, tails)
    refined = _refine(problem, state, options)
    if options.projector_distortion and not _is_distorted(refined[0], refined[1]):
        progress("projector without distortion")
        refined = _refine(*_without_distortion(problem, state), options)
    problem, state, inflation = refined
    progress("uncertainty")
    result = _result(problem, state, warnings, inflation, total)
    warnings += check_determined(result, problem, options.robot)
    if options.left_out:
        progress("views left out")
        result = replace(result, left_out=left_out_errors(problem, state))
    return result


def _reinstated(
    observations: Observations, normalised: Array, focal: float, rotation: Array, good: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return the views that fit once the dots are known; as they were where the good ones do not give any dots."""
    try:
        return reinstate(observations, normalised, focal, rotation, good)
    except SelfCalibrationError:
        return good


def _check_pixels(observations: Observations, camera: CameraModel) -> None:
    low, high = observations.pixels.min(0), observations.pixels.max(0)
    if low.min() < -1 or high[0] > camera.width or high[1] > camera.height:
        raise InvalidInputError(
            f"dots at pixels {low[0]:.0f},{low[1]:.0f} to {high[0]:.0f},{high[1]:.0f}, but the camera has"
            f" {camera.width}x{camera.height}: the intrinsics belong to another camera or resolution"
        )


def _free_camera(camera: CameraModel, refine: bool) -> NDArray[np.bool_]:
    names = lens.names(camera.distortion_model)
    # The sixth-order term of plumb_bob is left as it is: dots rarely reach the corners that would determine it.
    return np.array([refine and name != "k3" for name in names])


def _reject(problem: Problem, state: State, *, first: bool = False) -> tuple[Problem, State]:
    """Drop observations off by more than four standard deviations of their view, and dots with less than two left."""
    observations = problem.observations
    in_camera, in_projector = reprojection_errors(problem, state)
    right = right_observations(observations.view, in_camera, len(observations.names), least=2.0 if first else 0.2)
    # Before the first adjustment dots come from the cameras alone; later they are drawn to the projector's rays.
    limit = max(5 * float(np.median(in_projector)) / 1.1774, 3.0) if first else 6 * problem.projector_sigma
    observations = observations.select(right & (in_projector < limit)[observations.point])
    # A dot of a single view has nothing but the epipolar line to show that its code is right.
    seen = np.bincount(observations.point, minlength=len(observations.dots)) > (0 if first else 1)
    observations, points = drop_dots(observations, seen, state.points)
    _check_views_left(observations)
    return _changed(problem, replace(state, points=points), observations)


def _changed(problem: Problem, state: State, observations: Observations) -> tuple[Problem, State]:
    """Put other observations into a problem, with the displacements of their centroids."""
    modelled = problem.displacement is not None
    problem = replace(problem, observations=observations, displacement=None, smooth=None)
    return (_with_centroids(problem, state) if modelled else problem), state


def _check_views_left(observations: Observations) -> None:
    count = np.bincount(observations.view, minlength=len(observations.names))
    for name, n in zip(observations.names, count, strict=True):
        if n < 6:
            raise InconsistentPosesError(
                f"{name}: only {n} of its dots agree with the other views: the image belongs to another scene or pose;"
                " leave it out"
            )


def _robust(problem: Problem, state: State, warnings: list[str]) -> tuple[Problem, State, float]:
    """Adjust with a Huber loss, reject wrong codes and, one at a time, flange poses that do not fit.

    Also returns the share of errors between four and ten standard deviations.
    """
    tails = 0.0
    for attempt in range(len(problem.observations.names)):
        state = adjust(problem, state, iterations=30, tolerance=1e-6).state
        before = len(problem.observations.view)
        tails = max(tails, heavy_tails(problem.observations.view, reprojection_errors(problem, state)[0]))
        problem, state = _reject(problem, state)
        outlier = outlier_pose(problem, state)
        if outlier is not None:
            keep = np.arange(len(problem.observations.names)) != outlier.view
            if keep.sum() < consistency.LEAST_VIEWS or attempt > len(problem.observations.names) / 2:
                raise InconsistentPosesError(outlier.sentence)
            warnings.append(f"left out: {outlier.sentence}")
            problem, state = _without_views(problem, state, keep)
            consistency.check_motion(problem.observations.base_from_flange)
        elif before - len(problem.observations.view) < 1e-3 * before:
            break
    return problem, state, tails


def _without_views(problem: Problem, state: State, keep: NDArray[np.bool_]) -> tuple[Problem, State]:
    observations, _ = drop_views(problem.observations, keep, problem.observations.pixels)
    seen = np.bincount(observations.point, minlength=len(observations.dots)) > 0
    observations, points = drop_dots(observations, seen, state.points)
    if len(observations.names) < consistency.LEAST_VIEWS:
        raise TooFewViewsError(f"{len(observations.names)} views are left after outliers: add views")
    noise = replace(problem.noise, camera=problem.noise.camera[keep])
    problem = replace(problem, noise=noise, trusted=problem.trusted[keep])
    return _changed(problem, replace(state, points=points, base_from_flange=state.base_from_flange[keep]), observations)


def _refine(
    problem: Problem, state: State, options: SelfCalibrationOptions
) -> tuple[Problem, State, tuple[float, float]]:
    """Alternate least squares, the estimation of all noise from the residuals, and a last check for wrong codes."""
    # Too large figures of the robot's noise come down to the true ones in a few rounds, too small ones grow slowly.
    noise = problem.noise
    noise = replace(noise, position=3 * noise.position, rotation=3 * noise.rotation)
    problem = replace(problem, huber=np.inf, noise=noise)
    inflation = (1.0, 1.0)
    for i in range(_ROUNDS):
        state = adjust(problem, state, iterations=15, tolerance=1e-7).state
        lin = linearise(problem, state)
        noise = estimate(problem, lin, *covariance(normal_equations(problem, lin)), options.robot)
        problem = replace(problem, noise=noise)
        if i < _ROUNDS - 1:
            problem, state = _reject(problem, state)
            if problem.displacement is not None:
                problem = _with_centroids(problem, state)
    inflated, *factors = inflate(problem, linearise(problem, state))
    inflation = (factors[0], factors[1])
    state = adjust(inflated, state, iterations=10, tolerance=1e-9).state
    return inflated, state, inflation


def _covariances(problem: Problem, state: State) -> tuple[Array, Array]:
    """Return the covariances of the reduced parameters (P, P) and of the dots (K, 3, 3)."""
    found = covariance(normal_equations(problem, linearise(problem, state)))
    if problem.considered:
        found = consider(problem.layout, problem.considered, *found)
    return found[0], found[1]


def _start_centroids(problem: Problem, state: State, spot_diameter: float, tails: float) -> tuple[Problem, State]:
    """Model the displacement of centroids, with the dots' variance estimated or held at its prior.

    Errors with heavy tails show real images. Their light has further effects that no model here holds, alike enough to
    the modelled ones to mislead the estimate: then the variance of a disc is the better figure, and its uncertainty is
    passed on. Errors that follow the normal distribution allow to estimate it.
    """
    mean, spread = centroids.prior(spot_diameter)
    real = tails > HEAVY_TAILS
    state = replace(state, variance=mean)
    problem = replace(
        problem, variance_prior=(mean, 1e-3 * mean if real else 2 * mean), considered=spread if real else 0.0
    )
    return _with_centroids(problem, state), state


def _with_centroids(problem: Problem, state: State) -> Problem:
    displacement, smooth = centroids.displacements(
        problem.observations,
        state.points,
        state.base_from_flange @ state.flange_from_camera,
        state.base_from_projector,
        lens.with_parameters(problem.camera, state.camera),
        lens.with_parameters(problem.projector, state.projector),
    )
    return replace(problem, displacement=displacement, smooth=smooth)


def _with_distortion(problem: Problem, state: State) -> tuple[Problem, State]:
    """Set the projector's k1 free, at zero."""
    model = lens.with_parameters(problem.projector, state.projector)
    model = CameraModel(model.width, model.height, model.matrix, "plumb_bob", (0.0,) * 5)
    free = np.array([name in (*lens.MATRIX_PARAMETERS, "k1") for name in lens.names("plumb_bob")])
    bent = replace(problem, projector=model, free_projector=free)
    return bent, replace(state, projector=lens.parameters(model))


def _without_distortion(problem: Problem, state: State) -> tuple[Problem, State]:
    """Take the projector's distortion out again."""
    model = lens.with_parameters(problem.projector, state.projector)
    model = CameraModel(model.width, model.height, model.matrix)
    plain = replace(problem, projector=model, free_projector=np.ones(4, dtype=bool))
    return plain, replace(state, projector=lens.parameters(model))


def _is_distorted(problem: Problem, state: State) -> bool:
    """Tell whether the projector's k1 differs from zero by more than its uncertainty explains."""
    parameters, _ = _covariances(problem, state)
    index = problem.layout.projector.stop - 1
    sigma = float(np.sqrt(parameters[index, index]))
    return bool(abs(state.projector[4]) > SIGNIFICANT * sigma and sigma < 0.5)


def _result(
    problem: Problem, state: State, warnings: list[str], inflation: tuple[float, float], total: int
) -> SelfCalibration:
    observations, layout = problem.observations, problem.layout
    parameters, dots = _covariances(problem, state)
    in_camera, in_projector = reprojection_errors(problem, state)
    counts = np.bincount(observations.view, minlength=layout.views)
    squares = np.bincount(observations.view, in_camera**2, layout.views)
    correction = transforms.difference(observations.base_from_flange, state.base_from_flange)[problem.trusted]
    sigma = np.sqrt(np.diag(parameters))
    centred = state.points - state.points.mean(0)

    def named(model: str, free: NDArray[np.bool_], where: slice) -> dict[str, float]:
        names = [name for name, f in zip(lens.names(model), free, strict=True) if f]
        return dict(zip(names, sigma[where].tolist(), strict=True))

    return SelfCalibration(
        camera=lens.with_parameters(problem.camera, state.camera),
        projector=lens.with_parameters(problem.projector, state.projector),
        flange_from_camera=state.flange_from_camera,
        base_from_projector=state.base_from_projector,
        hand_eye_covariance=parameters[layout.hand_eye, layout.hand_eye],
        projector_pose_covariance=parameters[layout.pose, layout.pose],
        projector_sigma=named(problem.projector.distortion_model, problem.free_projector, layout.projector),
        camera_sigma=named(problem.camera.distortion_model, problem.free_camera, layout.camera),
        covariance=parameters[: layout.camera.stop, : layout.camera.stop],
        dots=observations.dots,
        points=state.points,
        point_covariance=dots,
        point_views=np.bincount(observations.point, minlength=len(observations.dots)),
        names=observations.names,
        view_rms=np.sqrt(squares / np.maximum(counts, 1)),
        rms=float(np.sqrt(np.mean(in_camera**2))),
        projector_rms=float(np.sqrt(np.mean(in_projector**2))),
        position_rms=float(np.sqrt(np.mean(correction[:, :3] ** 2))),
        rotation_rms=float(np.sqrt(np.mean(correction[:, 3:] ** 2))),
        left_out=LeftOut(),
        noise=problem.noise,
        inflation=inflation,
        dot_variance=(state.variance, float(sigma[layout.variance].sum())),
        observations=len(observations.view),
        rejected=total - len(observations.view),
        scene_depth=float(np.linalg.svd(centred, compute_uv=False)[-1] / np.sqrt(len(centred))),
        warnings=warnings,
    )
