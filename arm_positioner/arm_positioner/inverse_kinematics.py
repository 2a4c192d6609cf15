"""Inverse kinematics within joint limits: Levenberg-Marquardt from several seeds, deterministic."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from arm_positioner.errors import UnreachableError
from sl_common import transforms
from sl_common.kinematics import Kinematics

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class SolverOptions:
    """How the solver searches.

    Attributes:
        seeds: Starts beside the current joint positions.
        iterations: Steps from each start.
        position_tolerance: Residual of a solution [m].
        rotation_tolerance: Residual of a solution [rad].
        rotation_length: Length that makes an angle comparable with a distance in the cost [m/rad].
        seed: Seed of the random starts.
    """

    seeds: int = 24
    iterations: int = 80
    position_tolerance: float = 1e-6
    rotation_tolerance: float = 1e-6
    rotation_length: float = 0.3
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Solution:
    """Joint positions for a pose.

    Attributes:
        positions: (n,) [rad or m].
        position_error: Residual [m].
        rotation_error: Residual [rad].
        distance: Largest joint motion from the current positions in units of the joint's speed limit [s].
    """

    positions: Array
    position_error: float
    rotation_error: float
    distance: float


class InverseKinematics:
    """Finds joint positions that bring the tip of an arm to a pose.

    Args:
        kinematics: The arm; not shared with another thread.
        lower: (n,) lower position limits [rad or m].
        upper: (n,) upper position limits [rad or m].
        options: Of the search.
    """

    def __init__(
        self, kinematics: Kinematics, lower: ArrayLike, upper: ArrayLike, *, options: SolverOptions | None = None
    ) -> None:
        self.kinematics = kinematics
        self._lower = np.asarray(lower, dtype=np.float64)
        self._upper = np.asarray(upper, dtype=np.float64)
        self._options = options or SolverOptions()
        middle = np.where(
            np.isfinite(self._upper), 0.5 * (np.maximum(self._lower, -1e6) + np.minimum(self._upper, 1e6)), 0.0
        )
        self._is_revolute = np.linalg.norm(kinematics.jacobian(middle)[3:], axis=0) > 0.5
        self._speed = np.where(np.isfinite(kinematics.max_velocity), kinematics.max_velocity, 1.0)

    def nearby(self, base_from_tip: Array, start: ArrayLike, current: ArrayLike | None = None) -> Solution:
        """Return the solution that the search reaches from ``start`` (n,) alone: the one for following.

        Full turns are chosen to lie near the ``current`` joint positions (n,) where those are given.

        Raises UnreachableError with the residual that remains.
        """
        start = np.clip(np.asarray(start, dtype=np.float64), self._lower, self._upper)
        q = self._descend(base_from_tip, start)
        if current is not None:
            current = np.asarray(current, dtype=np.float64)
            q = self._towards(q, current)
        solution = self._measure(q, base_from_tip, start if current is None else current)
        if not self._solves(solution):
            raise UnreachableError(self._complaint(base_from_tip, solution))
        return solution

    def solve(self, base_from_tip: Array, current: ArrayLike) -> list[Solution]:
        """Return the distinct solutions found, the nearest to the current joint positions first.

        Args:
            base_from_tip: (4, 4) wanted pose of the tip [m].
            current: (n,) joint positions to stay near to [rad or m].

        Raises UnreachableError with the residual of the best try where there is none.
        """
        current = np.clip(np.asarray(current, dtype=np.float64), self._lower, self._upper)
        found: list[Solution] = []
        best: Solution | None = None
        for start in self._starts(current):
            q = self._towards(self._descend(base_from_tip, start), current)
            solution = self._measure(q, base_from_tip, current)
            if best is None or self._cost(solution) < self._cost(best):
                best = solution
            if self._solves(solution) and all(np.abs(s.positions - q).max() > 1e-3 for s in found):
                found.append(solution)
        if not found:
            assert best is not None
            raise UnreachableError(self._complaint(base_from_tip, best))
        return sorted(found, key=lambda s: s.distance)

    def _starts(self, current: Array) -> list[Array]:
        rng = np.random.default_rng(self._options.seed)
        low = np.maximum(self._lower, current - np.pi)
        high = np.minimum(self._upper, current + np.pi)
        spread = rng.uniform(low, high, size=(self._options.seeds, current.size))
        near = np.clip(current + rng.normal(scale=0.4, size=spread.shape), self._lower, self._upper)
        mixed = np.where(np.arange(self._options.seeds)[:, None] % 3 == 0, near, spread)
        return [current, *mixed]

    def _descend(self, target: Array, q: Array) -> Array:
        """Minimise the pose error by Levenberg-Marquardt steps projected onto the limits."""
        damping = 1e-3
        error = self._error(target, q)
        cost = error @ error
        for _ in range(self._options.iterations):
            jacobian = self.kinematics.jacobian(q)
            jacobian[3:] *= self._options.rotation_length
            gradient = jacobian.T @ error
            # a joint at its limit that the step would push further out stays there
            blocked = ((q <= self._lower) & (gradient < 0)) | ((q >= self._upper) & (gradient > 0))
            jacobian[:, blocked] = 0.0
            normal = jacobian.T @ jacobian
            improved = False
            for _ in range(6):
                step = np.linalg.solve(normal + damping * np.eye(q.size), jacobian.T @ error)
                longest = np.abs(step).max()
                candidate = np.clip(q + step * min(1.0, 0.8 / max(longest, 1e-12)), self._lower, self._upper)
                candidate_error = self._error(target, candidate)
                candidate_cost = candidate_error @ candidate_error
                if candidate_cost < cost:
                    q, error, improved = candidate, candidate_error, True
                    progress, cost = cost - candidate_cost, candidate_cost
                    damping = max(0.2 * damping, 1e-12)
                    break
                damping = min(10 * damping, 1e3)
            if not improved or cost < 1e-20 or progress < 1e-9 * cost:
                break
        return q

    def _error(self, target: Array, q: Array) -> Array:
        error = transforms.difference(self.kinematics.forward(q), target)
        error[3:] *= self._options.rotation_length
        return error

    def _towards(self, q: Array, current: Array) -> Array:
        """Shift revolute joints by full turns to lie nearest the current ones inside the limits."""
        turns = np.round((current - q) / (2 * np.pi)) * 2 * np.pi
        shifted = np.where(self._is_revolute, q + turns, q)
        return np.where((shifted >= self._lower) & (shifted <= self._upper), shifted, q)

    def _measure(self, q: Array, target: Array, current: Array) -> Solution:
        delta = transforms.difference(self.kinematics.forward(q), target)
        distance = float((np.abs(q - current) / self._speed).max())
        return Solution(q, float(np.linalg.norm(delta[:3])), float(np.linalg.norm(delta[3:])), distance)

    def _solves(self, solution: Solution) -> bool:
        return (
            solution.position_error <= self._options.position_tolerance
            and solution.rotation_error <= self._options.rotation_tolerance
        )

    def _cost(self, solution: Solution) -> float:
        return float(np.hypot(solution.position_error, self._options.rotation_length * solution.rotation_error))

    def _complaint(self, target: Array, best: Solution) -> str:
        x, y, z = target[:3, 3]
        return (
            f"pose at ({x:.3f}, {y:.3f}, {z:.3f}) m is out of reach within the joint limits: the nearest try "
            f"misses it by {1e3 * best.position_error:.1f} mm and {np.degrees(best.rotation_error):.2f} deg"
        )
