"""Self-calibration from known robot motion: projector, hand-eye transform and dots with their uncertainties."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration import consistency, lens
from sl_calibration.self_calibration.assembly import assemble
from sl_calibration.self_calibration.bundle_adjustment import adjust, covariance, normal_equations
from sl_calibration.self_calibration.bundle_problem import Noise, Problem, State, linearise
from sl_calibration.self_calibration.determinacy import check_determined
from sl_calibration.self_calibration.effects import (
    is_distorted,
    start_centroids,
    with_centroids,
    with_distortion,
    without_distortion,
)
from sl_calibration.self_calibration.errors import SelfCalibrationError
from sl_calibration.self_calibration.initialise import resect_projector, translation_and_points
from sl_calibration.self_calibration.left_out import left_out_errors
from sl_calibration.self_calibration.noise_model import RobotNoise, estimate, inflate
from sl_calibration.self_calibration.outliers import (
    complete_points,
    drop_dots,
    drop_views,
    reinstate,
    right_observations,
)
from sl_calibration.self_calibration.rejection import adjust_robustly, reject
from sl_calibration.self_calibration.relative_motion import pair_rotations
from sl_calibration.self_calibration.result import SelfCalibration
from sl_calibration.self_calibration.views import LEAST_DOTS, Observations, View, check_poses, flatten
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]
Progress = Callable[[str], None]

_ROUNDS = 5


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
    sparse = [v.name for v in views if len(v.usable().row) < LEAST_DOTS]
    views = [v for v in views if v.name not in sparse]
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
    warnings = [f"left out: {name} has fewer than {LEAST_DOTS} usable dots" for name in sparse]
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
    problem, state = reject(problem, state, warnings, first=True)
    progress("bundle adjustment")
    if options.projector_distortion:
        problem, state = with_distortion(problem, state)
    problem, state, tails = adjust_robustly(problem, state, warnings)
    if options.spot_diameter:
        problem, state = start_centroids(problem, state, options.spot_diameter, tails)
    refined = _refine(problem, state, options, warnings)
    if options.projector_distortion and not is_distorted(refined[0], refined[1]):
        progress("projector without distortion")
        refined = _refine(*without_distortion(problem, state), options, warnings)
    problem, state, inflation = refined
    progress("uncertainty")
    result = assemble(problem, state, warnings, inflation, total)
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


def _refine(
    problem: Problem, state: State, options: SelfCalibrationOptions, warnings: list[str]
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
            problem, state = reject(problem, state, warnings)
            if problem.displacement is not None:
                problem = with_centroids(problem, state)
    inflated, *factors = inflate(problem, linearise(problem, state))
    inflation = (factors[0], factors[1])
    state = adjust(inflated, state, iterations=10, tolerance=1e-9).state
    return inflated, state, inflation
