"""Closed forms of the hand-eye equation A X = X B: Tsai and Lenz 1989, Park and Martin 1994, Daniilidis 1999.

A: motions of the hand, hand_i_from_hand_j; B: motions of the eye, eye_i_from_eye_j; X: hand_from_eye. Only pairs that
turn far enough say something about the rotation, and pairs whose two angles differ are wrong: both are filtered
beforehand.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sl_common import transforms

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MotionPairs:
    """Relative motions.

    Attributes:
        hand: (P, 4, 4) motions A [m].
        eye: (P, 4, 4) motions B [m].
        agreement: Share of all pairs that turn far enough whose two angles agree.
        largest_angle: Largest angle between any two hand poses [rad].
    """

    hand: Array
    eye: Array
    agreement: float
    largest_angle: float

    @property
    def hand_vectors(self) -> Array:
        """(P, 3) rotation vectors of the hand's motions [rad]."""
        return transforms.rotation_log(self.hand[:, :3, :3])

    @property
    def eye_vectors(self) -> Array:
        """(P, 3) rotation vectors of the eye's motions [rad]."""
        return transforms.rotation_log(self.eye[:, :3, :3])

    @property
    def second_axis(self) -> float:
        """RMS angle [rad] that the hand turns about the second of its principal axes; 0 when all axes are one."""
        if len(self.hand) < 2:
            return 0.0
        values = np.linalg.svd(self.hand_vectors, compute_uv=False)
        return float(values[1] / np.sqrt(len(self.hand)))


def motion_pairs(
    base_from_hand: Array, eye_from_target: Array, *, least_angle: float, angle_tolerance: float
) -> MotionPairs:
    """Pair every two of N poses (N, 4, 4); keep those that turn by at least ``least_angle`` [rad] and agree."""
    i, j = np.triu_indices(len(base_from_hand), 1)
    hand = transforms.inverse(base_from_hand[i]) @ base_from_hand[j]
    eye = eye_from_target[i] @ transforms.inverse(eye_from_target[j])
    angle_hand, angle_eye = transforms.rotation_angle(hand), transforms.rotation_angle(eye)
    far = (angle_hand > least_angle) & (angle_hand < np.radians(175))
    agree = np.abs(angle_hand - angle_eye) < angle_tolerance
    share = float((far & agree).sum() / max(far.sum(), 1))
    keep = far & agree
    return MotionPairs(hand[keep], eye[keep], share, float(angle_hand.max(initial=0.0)))


def solve_park(pairs: MotionPairs) -> Array:
    """Return X (4, 4): rotation by least squares of the rotation vectors, then translation."""
    u, _, vt = np.linalg.svd(pairs.hand_vectors.T @ pairs.eye_vectors)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return transforms.make(rotation, _translation(pairs, rotation)[0])


def solve_tsai(pairs: MotionPairs) -> Array:
    """Return X (4, 4): rotation by modified Rodrigues vectors, then translation."""
    a, b = _modified_rodrigues(pairs.hand_vectors), _modified_rodrigues(pairs.eye_vectors)
    solution, *_ = np.linalg.lstsq(transforms.skew(a + b).reshape(-1, 3), (b - a).ravel(), rcond=None)
    p = 2 * solution / np.sqrt(1 + solution @ solution)
    rotation = (
        (1 - p @ p / 2) * np.eye(3) + 0.5 * (np.outer(p, p) + np.sqrt(max(4 - p @ p, 0.0)) * transforms.skew(p))
    )  # fmt: skip
    u, _, vt = np.linalg.svd(rotation)
    rotation = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    return transforms.make(rotation, _translation(pairs, rotation)[0])


def solve_daniilidis(pairs: MotionPairs) -> Array | None:
    """Return X (4, 4) by dual quaternions, rotation and translation at once; None where the null space is
    degenerate."""
    a, a_dual = _dual_quaternion(pairs.hand)
    b, b_dual = _dual_quaternion(pairs.eye)
    rows = np.zeros((len(a), 6, 8))
    rows[:, :3, 0] = a - b
    rows[:, :3, 1:4] = transforms.skew(a + b)
    rows[:, 3:, 0] = a_dual - b_dual
    rows[:, 3:, 1:4] = transforms.skew(a_dual + b_dual)
    rows[:, 3:, 4] = a - b
    rows[:, 3:, 5:] = transforms.skew(a + b)
    _, _, vt = np.linalg.svd(rows.reshape(-1, 8), full_matrices=False)
    first, second = vt[6], vt[7]
    alpha, beta, gamma = first[:4] @ first[4:], first[:4] @ second[4:] + second[:4] @ first[4:], second[:4] @ second[4:]
    if abs(alpha) < 1e-15:
        return None
    ratios = np.roots([alpha, beta, gamma])
    if np.iscomplexobj(ratios) and np.abs(ratios.imag).max() > 1e-6 * np.abs(ratios).max():
        ratios = np.repeat(-beta / (2 * alpha), 2)
    ratios = np.real(ratios)
    norms = [s * s * first[:4] @ first[:4] + 2 * s * first[:4] @ second[:4] + second[:4] @ second[:4] for s in ratios]
    s = ratios[int(np.argmax(norms))]
    scale = 1 / np.sqrt(max(norms))
    q, dual = scale * (s * first[:4] + second[:4]), scale * (s * first[4:] + second[4:])
    translation = 2 * _multiply(dual, q * (1, -1, -1, -1))[1:]
    return transforms.make(Rotation.from_quat(np.roll(q, -1)).as_matrix(), translation)


def length_ratio(pairs: MotionPairs, rotation: Array) -> float:
    """Return the factor on the eye's lengths that fits the hand's best: 1 when both are in the same unit."""
    return _translation(pairs, rotation, scaled=True)[1]


def _translation(pairs: MotionPairs, rotation: Array, *, scaled: bool = False) -> tuple[Array, float]:
    left = (np.eye(3) - pairs.hand[:, :3, :3]).reshape(-1, 3)
    moved = (pairs.eye[:, :3, 3] @ rotation.T).ravel()
    right = pairs.hand[:, :3, 3].ravel()
    if not scaled:
        return np.asarray(np.linalg.lstsq(left, right - moved, rcond=None)[0], dtype=np.float64), 1.0
    solution = np.linalg.lstsq(np.concatenate([left, moved[:, None]], axis=1), right, rcond=None)[0]
    return solution[:3], float(solution[3])


def _modified_rodrigues(vectors: Array) -> Array:
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return 2 * np.sin(angle / 2) * vectors / np.maximum(angle, 1e-12)


def _dual_quaternion(motions: Array) -> tuple[Array, Array]:
    """Vector parts (P, 3) of the real and the dual quaternion, w >= 0."""
    translation, xyzw = transforms.to_quaternion(motions)
    w, v = xyzw[:, 3:], xyzw[:, :3]
    return v, 0.5 * (w * translation + np.cross(translation, v))


def _multiply(p: Array, q: Array) -> Array:
    """Product of quaternions (4,), w first."""
    return np.concatenate([[p[0] * q[0] - p[1:] @ q[1:]], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])])
