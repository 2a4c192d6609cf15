"""Residuals of the self-calibration and their analytic derivatives.

Unknowns: hand-eye transform X, projector pose, projector and camera intrinsics (those set free), one flange pose per
view, and all dots in the base frame. Residuals, each divided by its standard deviation: camera pixels, projector
pixels, and the difference of every flange pose from the one that the robot reported. That last prior also fixes the
gauge: the base frame is the robot's.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration import lens
from sl_calibration.self_calibration.views import Observations
from sl_common import transforms
from sl_common.cameras import CameraModel

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

ROUGH = 10.0
"""How much larger the error of a dot's centre is at creases and edges: its centroid's displacement is unknown there."""

LEAST_SMOOTH = 100
"""With fewer dots away from creases and edges than this, all dots count alike."""


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard deviations.

    Attributes:
        camera: (V,) of a dot's centre in each view [px].
        projector: Of a dot's centre in the projected image [px]: what shifts a dot alike in all views.
        position: Of a reported flange position per axis [m].
        rotation: Of a reported flange rotation per axis [rad].
        freedom: Degrees of freedom that the figures of position and rotation rest on; inf: they are known.
    """

    camera: Array
    projector: float = 0.05
    position: float = 1e-4
    rotation: float = np.radians(0.02)
    freedom: tuple[float, float] = (np.inf, np.inf)


@dataclass(frozen=True, eq=False)
class State:
    """Values of all unknowns."""

    flange_from_camera: Array
    base_from_projector: Array
    projector: Array
    camera: Array
    base_from_flange: Array
    points: Array
    variance: float = 0.0


@dataclass(frozen=True, eq=False)
class Problem:
    """What stays fixed during an adjustment.

    Attributes:
        observations: M observations of K dots in V views; every dot is observed at least once.
        camera: Camera model, of which the distortion model and the fixed parameters count.
        projector: Projector model, likewise.
        free_camera: Which camera parameters (order of :func:`lens.names`) are unknowns.
        free_projector: Which projector parameters are unknowns.
        noise: Standard deviations.
        huber: Threshold of the Huber loss in standard deviations; inf: plain least squares.
        trusted: (V,) views whose reported flange pose counts.
        displacement: (M, 2) of each centroid from the image of the dot's centre, over one more unknown, the dots'
            variance [camera px / projector px^2], see :mod:`centroids`. None: left out.
        smooth: (K,) dots of which the displacement is known; the others count less.
        variance_prior: Mean and standard deviation of that unknown [projector px^2].
        considered: Standard deviation of that unknown [projector px^2] where it is held at its prior and its
            uncertainty only passed on; 0: estimated.
    """

    observations: Observations
    camera: CameraModel
    projector: CameraModel
    free_camera: BoolArray
    free_projector: BoolArray
    noise: Noise
    huber: float = np.inf
    trusted: BoolArray = field(default_factory=lambda: np.ones(0, dtype=bool))
    displacement: Array | None = None
    smooth: BoolArray | None = None
    variance_prior: tuple[float, float] = (0.0, 1.0)
    considered: float = 0.0

    def __post_init__(self) -> None:
        if len(self.trusted) == 0:
            object.__setattr__(self, "trusted", np.ones(len(self.observations.names), dtype=bool))

    @property
    def smooth_dots(self) -> BoolArray:
        """Dots (K,) away from creases and edges; all, where few are or the centres prove exact."""
        if self.smooth is None or not self.considered or self.smooth.sum() < LEAST_SMOOTH:
            return np.ones(len(self.observations.dots), dtype=bool)
        return self.smooth

    @property
    def projector_sigma(self) -> Array:
        """Standard deviations (K,) of the dots' centres in the projected image [px]."""
        return self.noise.projector * np.where(self.smooth_dots, 1.0, ROUGH)

    @property
    def layout(self) -> "Layout":
        """Where each unknown lies in the vector of the reduced system."""
        return Layout(
            int(self.free_projector.sum()),
            int(self.free_camera.sum()),
            len(self.observations.names),
            int(self.displacement is not None),
        )


@dataclass(frozen=True)
class Layout:
    """Slices of the reduced parameter vector: hand-eye 6, projector pose 6, projector, camera, variance, 6 per view."""

    projector_size: int
    camera_size: int
    views: int
    variance_size: int = 0

    @property
    def hand_eye(self) -> slice:
        """Hand-eye transform: x y z rx ry rz in the flange frame."""
        return slice(0, 6)

    @property
    def pose(self) -> slice:
        """Projector pose: x y z rx ry rz in the base frame."""
        return slice(6, 12)

    @property
    def projector(self) -> slice:
        """Free projector parameters."""
        return slice(12, 12 + self.projector_size)

    @property
    def camera(self) -> slice:
        """Free camera parameters."""
        return slice(self.projector.stop, self.projector.stop + self.camera_size)

    @property
    def variance(self) -> slice:
        """The variance of the dots, or nothing."""
        return slice(self.camera.stop, self.camera.stop + self.variance_size)

    def view(self, i: int) -> slice:
        """Flange pose of view i: x y z rx ry rz in the base frame."""
        start = self.variance.stop + 6 * i
        return slice(start, start + 6)

    @property
    def size(self) -> int:
        """Number of parameters of the reduced system."""
        return self.view(self.views).start


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Weighted residuals and derivatives at a state.

    Attributes:
        camera_residual: (M, 2) measured minus predicted, in standard deviations.
        camera_common: (M, 2, 6 + C) derivative of the prediction by hand-eye transform, free camera
            parameters and variance of the dots.
        camera_view: (M, 2, 6) by the flange pose of the view.
        camera_point: (M, 2, 3) by the dot.
        projector_residual: (K, 2).
        projector_common: (K, 2, 6 + P) by projector pose and free projector parameters.
        projector_point: (K, 2, 3) by the dot.
        pose_residual: (V, 6) reported minus estimated flange pose.
        pose_slope: (V, 6) derivative of the estimate, diagonal.
        variance_residual: Prior mean minus variance of the dots, and its slope.
        cost: Half the sum of squares, or of the Huber loss.
    """

    camera_residual: Array
    camera_common: Array
    camera_view: Array
    camera_point: Array
    projector_residual: Array
    projector_common: Array
    projector_point: Array
    pose_residual: Array
    pose_slope: Array
    variance_residual: tuple[float, float]
    cost: float


def camera_points(state: State, observations: Observations) -> tuple[Array, Array]:
    """Return the observed dots in the flange frame and in the camera frame of their views, (M, 3) each."""
    poses = state.base_from_flange[observations.view]
    offset = state.points[observations.point] - poses[:, :3, 3]
    in_flange = np.einsum("nji,nj->ni", poses[:, :3, :3], offset)
    hand_eye = state.flange_from_camera
    return in_flange, (in_flange - hand_eye[:3, 3]) @ hand_eye[:3, :3]


def linearise(problem: Problem, state: State) -> Linearisation:
    """Evaluate all residuals and derivatives at a state, weighted by standard deviations and the Huber loss."""
    observations, noise = problem.observations, problem.noise
    poses = state.base_from_flange[observations.view]
    in_flange, in_camera = camera_points(state, observations)
    pixels, by_point, by_camera = lens.project(problem.camera.distortion_model, state.camera, in_camera)
    hand_eye = state.flange_from_camera
    camera_from_flange = hand_eye[:3, :3].T
    by_flange = by_point @ camera_from_flange
    flange_from_base = np.swapaxes(poses[:, :3, :3], -1, -2)
    by_base = by_flange @ flange_from_base
    offset = state.points[observations.point] - poses[:, :3, 3]
    by_hand_eye = np.concatenate([-by_flange, by_flange @ transforms.skew(in_flange - hand_eye[:3, 3])], axis=-1)
    by_view = np.concatenate([-by_base, by_base @ transforms.skew(offset)], axis=-1)
    camera_common = np.concatenate([by_hand_eye, by_camera[:, :, problem.free_camera]], axis=-1)
    if problem.displacement is not None:
        pixels = pixels + state.variance * problem.displacement
        camera_common = np.concatenate([camera_common, problem.displacement[:, :, None]], axis=-1)
    residual = (observations.pixels - pixels) / noise.camera[observations.view][:, None]
    weight, camera_cost = _huber(residual, problem.huber)
    scale = (weight / noise.camera[observations.view])[:, None, None]

    pose = state.base_from_projector
    from_projector = state.points - pose[:3, 3]
    in_projector = from_projector @ pose[:3, :3]
    seen, by_local, by_projector = lens.project(problem.projector.distortion_model, state.projector, in_projector)
    by_world = by_local @ pose[:3, :3].T
    by_pose = np.concatenate([-by_world, by_world @ transforms.skew(from_projector)], axis=-1)
    projector_sigma = problem.projector_sigma
    projector_residual = (observations.projector_pixels - seen) / projector_sigma[:, None]
    projector_weight, projector_cost = _huber(projector_residual, problem.huber)
    projector_scale = (projector_weight / projector_sigma)[:, None, None]

    mean, spread = problem.variance_prior
    variance_residual = (mean - state.variance) / spread if problem.displacement is not None else 0.0
    sigma = np.repeat([noise.position, noise.rotation], 3)
    difference = -transforms.difference(observations.base_from_flange, state.base_from_flange) / sigma
    both = difference.reshape(-1, 2, 3)
    pose_weight, pose_cost = _huber(both, problem.huber)
    pose_weight = np.repeat(pose_weight, 3, axis=-1) * problem.trusted[:, None]

    return Linearisation(
        camera_residual=residual * weight[:, None],
        camera_common=camera_common * scale,
        camera_view=by_view * scale,
        camera_point=by_base * scale,
        projector_residual=projector_residual * projector_weight[:, None],
        projector_common=np.concatenate([by_pose, by_projector[:, :, problem.free_projector]], axis=-1)
        * projector_scale,
        projector_point=by_world * projector_scale,
        pose_residual=difference * pose_weight,
        pose_slope=pose_weight / sigma,
        variance_residual=(variance_residual, 1 / spread),
        cost=float(camera_cost.sum() + projector_cost.sum() + (pose_cost * problem.trusted[:, None]).sum())
        + 0.5 * variance_residual**2,
    )


def _huber(residual: Array, threshold: float) -> tuple[Array, Array]:
    """Return the square roots of the weights (...) and the losses (...) of residual vectors (..., n)."""
    length = np.linalg.norm(residual, axis=-1)
    inside = length <= threshold
    with np.errstate(invalid="ignore"):
        weight = np.sqrt(np.where(inside, 1.0, threshold / np.maximum(length, 1e-300)))
        loss = np.where(inside, 0.5 * length**2, threshold * (length - 0.5 * threshold))
    return (np.ones_like(length), 0.5 * length**2) if np.isinf(threshold) else (weight, loss)


def update(problem: Problem, state: State, step: Array, point_step: Array) -> State:
    """Apply a step (P,) of the reduced parameters and (K, 3) of the dots; poses by :func:`transforms.perturb`."""
    layout = problem.layout
    projector, camera = state.projector.copy(), state.camera.copy()
    projector[problem.free_projector] += step[layout.projector]
    camera[problem.free_camera] += step[layout.camera]
    return replace(
        state,
        flange_from_camera=transforms.perturb(state.flange_from_camera, step[layout.hand_eye]),
        base_from_projector=transforms.perturb(state.base_from_projector, step[layout.pose]),
        projector=projector,
        camera=camera,
        variance=state.variance + float(step[layout.variance].sum()),
        base_from_flange=transforms.perturb(state.base_from_flange, step[layout.view(0).start :].reshape(-1, 6)),
        points=state.points + point_step,
    )
