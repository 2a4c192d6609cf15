"""From a wanted camera pose to joint positions that can be driven to."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from arm_positioner.errors import InvalidGoalError, JointLimitError, PositionerError, SingularityError, UnreachableError
from arm_positioner.inverse_kinematics import InverseKinematics, Solution, SolverOptions
from arm_positioner.limits import JointLimits
from arm_positioner.singularity import Conditioning, SingularityThresholds, first_violation
from arm_positioner.trajectory import Trajectory
from sl_common import transforms
from sl_common.kinematics import Kinematics

Array = NDArray[np.float64]
Preview = Callable[[Array], Trajectory]

_PATH_SAMPLES = 60
_NEAR = 0.5
"""Joint motion [rad or m] below which another solution cannot be expected to be nearer."""
_ROLL_STEPS = 12
"""Rolls tried to either side, up to half a turn."""
REFUSALS = (UnreachableError, JointLimitError, SingularityError)
"""What is wrong with a goal that another one may do better."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Where to go.

    Attributes:
        positions: (n,) joint positions [rad or m].
        base_from_camera: (4, 4) camera pose there [m].
        condition: Worst condition number on the way [1].
    """

    positions: Array
    base_from_camera: Array
    condition: float


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
        self._conditioning = Conditioning(kinematics)
        lower, upper = limits.inside(margin)
        self._solver = InverseKinematics(kinematics, lower, upper, options=options)

    def choose(
        self,
        base_from_camera: Array,
        flange_from_camera: Array,
        current: Array,
        preview: Preview,
        *,
        free_roll: bool = False,
    ) -> Plan:
        """Return where to drive.

        Args:
            base_from_camera: (4, 4) wanted camera pose [m].
            flange_from_camera: (4, 4) hand-eye transform [m].
            current: (n,) joint positions now [rad or m].
            preview: Plans the motion to joint positions (n,) without starting it.
            free_roll: The camera may be turned about its optical axis: as little as it takes for a way on which the arm
                need not slow down, or else to where the way is best conditioned.

        Raises InvalidGoalError, UnreachableError, JointLimitError or SingularityError; the last two say what is wrong
        with the nearest solution.
        """
        if not transforms.is_rigid(base_from_camera):
            raise InvalidGoalError("goal pose is not a finite rigid transform")
        camera_from_flange = transforms.inverse(flange_from_camera)
        plans: list[Plan] = []
        refused: PositionerError | None = None
        starts = [current]
        for roll in _rolls(free_roll):
            pose = base_from_camera @ transforms.make(transforms.rotation_exp((0.0, 0.0, roll)), np.zeros(3))
            tip = pose @ camera_from_flange
            candidates = self._candidates(tip, current) if roll == 0.0 else self._beside(tip, current, starts)
            try:
                positions, condition = self._first_regular(candidates, preview)
            except REFUSALS as error:
                refused = refused or error
                continue
            plans.append(Plan(positions, pose, condition))
            starts = [current, *(plan.positions for plan in plans[-2:])]
            if condition <= self._thresholds.slow:
                return plans[-1]
        if plans:
            return min(plans, key=lambda plan: plan.condition)
        assert refused is not None
        raise type(refused)(f"{refused}; no roll of the camera is better") if free_roll else refused

    def follow(self, base_from_camera: Array, flange_from_camera: Array, current: Array) -> Solution:
        """Return the joint positions for a target that moved a little, found from ``current`` in the same posture.

        Raises InvalidGoalError, UnreachableError or SingularityError.
        """
        if not transforms.is_rigid(base_from_camera):
            raise InvalidGoalError("goal pose is not a finite rigid transform")
        solution = self._solver.nearby(base_from_camera @ transforms.inverse(flange_from_camera), current)
        step = solution.positions - current
        samples = int(np.clip(np.ceil(np.abs(step).max() / 0.05) + 1, 2, _PATH_SAMPLES))
        path = current + np.linspace(0.0, 1.0, samples)[:, None] * step
        require_regular(self._conditioning, path, self._thresholds)
        return solution

    def _first_regular(self, candidates: Iterator[Solution], preview: Preview) -> tuple[Array, float]:
        """Return the first solution that can be driven to and the worst condition number on the way; raises what is
        wrong with the first.
        """
        refused: PositionerError | None = None
        for solution in candidates:
            try:
                trajectory = preview(solution.positions)
                return solution.positions, require_regular_motion(self._conditioning, trajectory, self._thresholds)
            except (JointLimitError, SingularityError) as error:
                refused = refused or error
        assert refused is not None
        raise refused

    def _candidates(self, base_from_tip: Array, current: Array) -> Iterator[Solution]:
        """Yield solutions, the nearest first; the full search is spared where one is near and its way is free."""
        with suppress(UnreachableError):
            solution = self._solver.nearby(base_from_tip, current)
            if np.abs(solution.positions - current).max() < _NEAR:
                yield solution
        yield from self._solver.solve(base_from_tip, current)

    def _beside(self, base_from_tip: Array, current: Array, starts: list[Array]) -> Iterator[Solution]:
        """Yield the solutions reached from ``starts``; raises UnreachableError where there is none."""
        found = []
        for start in starts:
            with suppress(UnreachableError):
                found.append(self._solver.nearby(base_from_tip, start, current))
        if not found:
            raise UnreachableError("no joint positions for this roll of the camera")
        yield from sorted(found, key=lambda solution: solution.distance)


def _rolls(free: bool) -> list[float]:
    """Return the angles to turn the camera by [rad], the least first."""
    if not free:
        return [0.0]
    steps = np.pi / _ROLL_STEPS * np.arange(1, _ROLL_STEPS + 1)
    return [0.0, *np.stack([steps, -steps], axis=1).ravel()[:-1].tolist()]


def require_regular_motion(
    conditioning: Conditioning, trajectory: Trajectory, thresholds: SingularityThresholds
) -> float:
    """Return the worst condition number along a trajectory; raises SingularityError where it is not allowed."""
    path, _, _ = trajectory.sample(max(trajectory.duration / _PATH_SAMPLES, 1e-3))
    return require_regular(conditioning, path, thresholds)


def require_regular(conditioning: Conditioning, path: Array, thresholds: SingularityThresholds) -> float:
    """Return the worst condition number at joint positions (N, n); raises SingularityError where it is not allowed."""
    conditions = conditioning.along(path)
    bad = first_violation(conditions, thresholds)
    if bad >= 0:
        raise SingularityError(
            f"motion refused: {100 * bad / max(len(path) - 1, 1):.0f} % along the way the condition number is "
            f"{conditions[bad]:.0f}, limit {thresholds.stop:.0f} ({conditions[0]:.0f} at the start, "
            f"{conditions[-1]:.0f} at the goal); choose another start or goal"
        )
    return float(conditions.max())
