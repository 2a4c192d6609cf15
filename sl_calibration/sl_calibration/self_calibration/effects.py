"""Which effects a problem models beyond pinholes: the projector's radial distortion and the displacement of
centroids."""

from dataclasses import replace

import numpy as np

from sl_calibration.self_calibration import centroids, lens
from sl_calibration.self_calibration.bundle_problem import Problem, State
from sl_calibration.self_calibration.uncertainty import covariances
from sl_common.cameras import CameraModel

HEAVY_TAILS = 0.005
"""Share of errors between four and ten standard deviations from which on they are not normal; normal ones: 0.0003."""

SIGNIFICANT = 3.0
"""Standard deviations by which the projector's distortion must differ from zero to be kept."""


def start_centroids(problem: Problem, state: State, spot_diameter: float, tails: float) -> tuple[Problem, State]:
    """Model the displacement of centroids, with the dots' variance estimated or held at its prior.

    Errors with heavy tails show real images. Their light has further effects that no model here holds, alike enough to
    the modelled ones to mislead the estimate: then the variance of a disc is the better figure, and its uncertainty is
    passed on. Errors that follow the normal distribution allow to estimate it.

    Args:
        problem: Without such a model.
        state: Its state.
        spot_diameter: Of the dots [projector px].
        tails: Share of errors between four and ten standard deviations.
    """
    mean, spread = centroids.prior(spot_diameter)
    real = tails > HEAVY_TAILS
    state = replace(state, variance=mean)
    problem = replace(
        problem, variance_prior=(mean, 1e-3 * mean if real else 2 * mean), considered=spread if real else 0.0
    )
    return with_centroids(problem, state), state


def with_centroids(problem: Problem, state: State) -> Problem:
    """Return the problem with the displacements of centroids as the dots of a state show them."""
    displacement, smooth = centroids.displacements(
        problem.observations,
        state.points,
        state.base_from_flange @ state.flange_from_camera,
        state.base_from_projector,
        lens.with_parameters(problem.camera, state.camera),
        lens.with_parameters(problem.projector, state.projector),
    )
    return replace(problem, displacement=displacement, smooth=smooth)


def with_distortion(problem: Problem, state: State) -> tuple[Problem, State]:
    """Set the projector's k1 free, at zero."""
    model = lens.with_parameters(problem.projector, state.projector)
    model = CameraModel(model.width, model.height, model.matrix, "plumb_bob", (0.0,) * 5)
    free = np.array([name in (*lens.MATRIX_PARAMETERS, "k1") for name in lens.names("plumb_bob")])
    bent = replace(problem, projector=model, free_projector=free)
    return bent, replace(state, projector=lens.parameters(model))


def without_distortion(problem: Problem, state: State) -> tuple[Problem, State]:
    """Take the projector's distortion out again."""
    model = lens.with_parameters(problem.projector, state.projector)
    model = CameraModel(model.width, model.height, model.matrix)
    plain = replace(problem, projector=model, free_projector=np.ones(4, dtype=bool))
    return plain, replace(state, projector=lens.parameters(model))


def is_distorted(problem: Problem, state: State) -> bool:
    """Tell whether the projector's k1 differs from zero by more than its uncertainty explains."""
    index = problem.layout.projector.stop - 1
    sigma = float(np.sqrt(covariances(problem, state).parameters[index, index]))
    return bool(abs(state.projector[4]) > SIGNIFICANT * sigma and sigma < 0.5)
