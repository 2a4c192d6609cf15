"""From a wanted camera pose to joint positions that can be driven to."""

from collections.abc import Callable, Iterator
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from arm_positioner.errors import InvalidGoalError, JointLimitError, PositionerError, SingularityError, UnreachableError
from arm_positioner.inverse_kinematics import InverseKinematics, Solution, SolverOptions
from arm_positioner.limits import JointLimits
from arm_positioner.singularity import SingularityThresholds, conditions_along, first_violation
from arm_positioner.trajectory import Trajectory
from sl_common import transforms
from sl_common.kinematics import Kinematics

Array = NDArray[np.float64]

_PATH_SAMPLES = 60
_NEAR = 0.5
"""Joint motion [rad or m] below which another solution cannot be expected to be nearer."""


class Planner:
    """Chooses among the solutions of inverse kinematics the nearest one whose way is free of singularities.

    Args:
        kinematics: The arm up to the flange; not shared with another thread.
        limits: Limits of the joints.
        margin: Distance that goals keep from the position limits [rad or m].
        thresholds: Of the condition number.
        options: Of the search.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        limits: JointLimits,
        *,
        margin: float = 0.02,
        thresholds: SingularityThresholds | None = None,
        options: SolverOptions | None = None,
    ) -> None:
        self._thresholds = thresholds or SingularityThresholds()
        lower, upper = limits.inside(margin)
        self._solver = InverseKinematics(kinematics, lower, upper, options=options)

    def choose(
        self, base_from_camera: Array, flange_from_camera: Array, current: Array, preview: Callable[[Array], Trajectory]
    ) -> tuple[Solution, float]:
        """Return the joint positions to drive to and the worst condition number on the way.

        Args:
            base_from_camera: (4, 4) wanted camera pose [m].
            flange_from_camera: (4, 4) hand-eye transform [m].
            current: (n,) joint positions now [rad or m].
            preview: Plans the motion to joint positions (n,) without starting it.

        Raises InvalidGoalError, UnreachableError, JointLimitError or SingularityError; the last two say what is wrong
        with the nearest solution.
        """
        refused: PositionerError | None = None
        for solution in self._candidates(self._tip(base_from_camera, flange_from_camera), current):
            try:
                trajectory = preview(solution.positions)
                return solution, require_regular_motion(self._solver.kinematics, trajectory, self._thresholds)
            except (JointLimitError, SingularityError) as error:
                refused = refused or error
        assert refused is not None
        raise refused

    def follow(self, base_from_camera: Array, flange_from_camera: Array, current: Array) -> Solution:
        """Return the joint positions for a target that moved a little, found from ``current`` in the same posture.

        Raises InvalidGoalError, UnreachableError or SingularityError.
        """
        solution = self._solver.nearby(self._tip(base_from_camera, flange_from_camera), current)
        step = solution.positions - current
        samples = int(np.clip(np.ceil(np.abs(step).max() / 0.05) + 1, 2, _PATH_SAMPLES))
        path = current + np.linspace(0.0, 1.0, samples)[:, None] * step
        require_regular(self._solver.kinematics, path, self._thresholds)
        return solution

    def _candidates(self, base_from_tip: Array, current: Array) -> Iterator[Solution]:
        """Yield solutions, the nearest first; the full search is spared where one is near and its way is free."""
        with suppress(UnreachableError):
            solution = self._solver.nearby(base_from_tip, current)
            if np.abs(solution.positions - current).max() < _NEAR:
                yield solution
        yield from self._solver.solve(base_from_tip, current)

    def _tip(self, base_from_camera: Array, flange_from_camera: Array) -> Array:
        if not transforms.is_rigid(base_from_camera):
            raise InvalidGoalError("goal pose is not a finite rigid transform")
        return base_from_camera @ transforms.inverse(flange_from_camera)


def require_regular_motion(kinematics: Kinematics, trajectory: Trajectory, thresholds: SingularityThresholds) -> float:
    """Return the worst condition number along a trajectory; raises SingularityError where it is not allowed."""
    path, _, _ = trajectory.sample(max(trajectory.duration / _PATH_SAMPLES, 1e-3))
    return require_regular(kinematics, path, thresholds)


def require_regular(kinematics: Kinematics, path: Array, thresholds: SingularityThresholds) -> float:
    """Return the worst condition number at joint positions (N, n); raises SingularityError where it is not allowed."""
    conditions = conditions_along(kinematics, path)
    bad = first_violation(conditions, thresholds)
    if bad >= 0:
        raise SingularityError(
            f"motion refused: {100 * bad / max(len(path) - 1, 1):.0f} % along the way the condition number is "
            f"{conditions[bad]:.0f}, limit {thresholds.stop:.0f}; choose another start or goal"
        )
    return float(conditions.max())
