"""The result of a self-calibration from its adjusted problem."""

import numpy as np
from numpy.typing import NDArray

from sl_calibration.self_calibration import lens
from sl_calibration.self_calibration.bundle_problem import Problem, State
from sl_calibration.self_calibration.outliers import reprojection_errors
from sl_calibration.self_calibration.result import LeftOut, SelfCalibration
from sl_calibration.self_calibration.uncertainty import covariances
from sl_common import transforms


def assemble(
    problem: Problem, state: State, warnings: list[str], inflation: tuple[float, float], total: int
) -> SelfCalibration:
    """Return the result, without the errors of views left out.

    Args:
        problem: Adjusted, with the noise estimated.
        state: At its minimum.
        warnings: Views left out and why.
        inflation: Variance factors for correlated errors, of camera and projector.
        total: Number of observations given.
    """
    observations, layout = problem.observations, problem.layout
    found = covariances(problem, state)
    parameters, dots = found.parameters, found.dots
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
