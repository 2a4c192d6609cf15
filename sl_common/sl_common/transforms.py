"""Rigid transforms as 4x4 matrices: ``p_a = a_from_b @ p_b``.

All functions broadcast over leading dimensions, take and return float64, lengths in metres and angles in radians.
Quaternions are in ROS order, x y z w. Twists are ordered translation first: (v, w).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]


def identity() -> Array:
    """Return the 4x4 identity."""
    return np.eye(4)


def make(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """Build transforms (..., 4, 4) from rotations (..., 3, 3) and translations (..., 3) [m]."""
    rotation = np.asarray(rotation, dtype=np.float64)
    translation = np.asarray(translation, dtype=np.float64)
    shape = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    out = np.zeros((*shape, 4, 4))
    out[..., :3, :3] = rotation
    out[..., :3, 3] = translation
    out[..., 3, 3] = 1.0
    return out


def inverse(transform: ArrayLike) -> Array:
    """Invert rigid transforms (..., 4, 4): ``b_from_a`` from ``a_from_b``."""
    transform = np.asarray(transform, dtype=np.float64)
    rotation = np.swapaxes(transform[..., :3, :3], -1, -2)
    translation = -(rotation @ transform[..., :3, 3:])[..., 0]
    return make(rotation, translation)


def apply(transform: ArrayLike, points: ArrayLike) -> Array:
    """Map points (..., N, 3) [m] of frame b into frame a by ``a_from_b`` (..., 4, 4)."""
    transform = np.asarray(transform, dtype=np.float64)
    points = np.asarray(points, dtype=np.float64)
    return points @ np.swapaxes(transform[..., :3, :3], -1, -2) + transform[..., None, :3, 3]


def skew(vector: ArrayLike) -> Array:
    """Return matrices (..., 3, 3) with ``skew(a) @ b = a x b`` for vectors (..., 3)."""
    v = np.asarray(vector, dtype=np.float64)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def rotation_exp(rotation_vector: ArrayLike) -> Array:
    """Return rotations (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    r = np.asarray(rotation_vector, dtype=np.float64)
    return Rotation.from_rotvec(r.reshape(-1, 3)).as_matrix().reshape(*r.shape[:-1], 3, 3)


def rotation_log(rotation: ArrayLike) -> Array:
    """Return rotation vectors (..., 3) [rad], of length at most pi, of rotations (..., 3, 3)."""
    m = np.asarray(rotation, dtype=np.float64)
    return Rotation.from_matrix(m.reshape(-1, 3, 3)).as_rotvec().reshape(*m.shape[:-2], 3)


def rotation_angle(rotation: ArrayLike) -> Array:
    """Return the angles [rad] in 0..pi of rotations (..., 3, 3) or transforms (..., 4, 4)."""
    m = np.asarray(rotation, dtype=np.float64)[..., :3, :3]
    return np.linalg.norm(rotation_log(m), axis=-1)


def _left_jacobian(rotation_vector: Array) -> Array:
    """Return V of SE(3), with translation = V v, for rotation vectors (..., 3)."""
    angle = np.linalg.norm(rotation_vector, axis=-1)[..., None, None]
    s = skew(rotation_vector)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 0.5 - angle**2 / 24, (1 - np.cos(safe)) / safe**2)
    b = np.where(small, 1 / 6 - angle**2 / 120, (safe - np.sin(safe)) / safe**3)
    return np.eye(3) + a * s + b * (s @ s)


def exp(twist: ArrayLike) -> Array:
    """Return transforms (..., 4, 4) of twists (..., 6): (v [m], w [rad])."""
    twist = np.asarray(twist, dtype=np.float64)
    v, w = twist[..., :3], twist[..., 3:]
    return make(rotation_exp(w), (_left_jacobian(w) @ v[..., None])[..., 0])


def log(transform: ArrayLike) -> Array:
    """Return twists (..., 6): (v [m], w [rad]) of transforms (..., 4, 4), the inverse of :func:`exp`."""
    transform = np.asarray(transform, dtype=np.float64)
    w = rotation_log(transform[..., :3, :3])
    v = np.linalg.solve(_left_jacobian(w), transform[..., :3, 3:])[..., 0]
    return np.concatenate([v, w], axis=-1)


def perturb(transform: ArrayLike, delta: ArrayLike) -> Array:
    """Move poses (..., 4, 4) by ``delta`` (..., 6): (x y z [m], rx ry rz [rad]), both in the parent frame.

    This is the convention of every 6x6 covariance of the stack: t' = t + x, R' = exp(r) R.
    """
    transform = np.asarray(transform, dtype=np.float64)
    delta = np.asarray(delta, dtype=np.float64)
    return make(rotation_exp(delta[..., 3:]) @ transform[..., :3, :3], transform[..., :3, 3] + delta[..., :3])


def difference(a: ArrayLike, b: ArrayLike) -> Array:
    """Return the ``delta`` (..., 6) [m, rad] with ``b = perturb(a, delta)``."""
    a = np.asarray(a, dtype=np.float64)
    b = np.asarray(b, dtype=np.float64)
    rotation = rotation_log(b[..., :3, :3] @ np.swapaxes(a[..., :3, :3], -1, -2))
    return np.concatenate([b[..., :3, 3] - a[..., :3, 3], rotation], axis=-1)


def from_quaternion(translation: ArrayLike, quaternion: ArrayLike) -> Array:
    """Build transforms (..., 4, 4) from translations (..., 3) [m] and quaternions (..., 4), x y z w.

    Quaternions are normalised. Raises InvalidInputError where one is zero or not finite.
    """
    q = np.asarray(quaternion, dtype=np.float64)
    norm = np.linalg.norm(q, axis=-1)
    if not np.all(np.isfinite(norm) & (norm > 1e-6)):
        raise InvalidInputError(f"quaternion with norm {np.min(norm):g}: expected unit length (x y z w)")
    rotation = Rotation.from_quat(q.reshape(-1, 4)).as_matrix().reshape(*q.shape[:-1], 3, 3)
    return make(rotation, translation)


def to_quaternion(transform: ArrayLike) -> tuple[Array, Array]:
    """Split transforms (..., 4, 4) into translations (..., 3) [m] and quaternions (..., 4), x y z w, w >= 0."""
    transform = np.asarray(transform, dtype=np.float64)
    rotation = transform[..., :3, :3]
    q = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat().reshape(*rotation.shape[:-2], 4)
    return transform[..., :3, 3].copy(), np.where(q[..., 3:] < 0, -q, q)


def interpolate(a: ArrayLike, b: ArrayLike, s: ArrayLike) -> Array:
    """Interpolate poses: position linearly, rotation at constant angular velocity; s = 0 gives a, 1 gives b."""
    s = np.asarray(s, dtype=np.float64)
    return perturb(a, s[..., None] * difference(a, b))


def look_at(position: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Array:
    """Return base_from_camera (4, 4) of a camera at ``position`` looking at ``target``, image up along ``up``.

    Raises InvalidInputError where the target is at the position or straight along ``up``.
    """
    position = np.asarray(position, dtype=np.float64)
    z = np.asarray(target, dtype=np.float64) - position
    x = np.cross(z, np.asarray(up, dtype=np.float64))
    if np.linalg.norm(z) < 1e-9 or np.linalg.norm(x) < 1e-9 * np.linalg.norm(z):
        raise InvalidInputError("look_at: the target must differ from the position and not lie along the up direction")
    z /= np.linalg.norm(z)
    x /= np.linalg.norm(x)
    return make(np.stack([x, np.cross(z, x), z], axis=-1), position)


def is_rigid(transform: ArrayLike, tolerance: float = 1e-6) -> bool:
    """Tell whether a 4x4 matrix is finite, has a proper rotation within ``tolerance`` and the last row 0 0 0 1."""
    t = np.asarray(transform, dtype=np.float64)
    if t.shape != (4, 4) or not np.all(np.isfinite(t)):
        return False
    rotation = t[:3, :3]
    orthogonal = np.allclose(rotation @ rotation.T, np.eye(3), atol=tolerance)
    return bool(orthogonal and np.linalg.det(rotation) > 0 and np.allclose(t[3], (0, 0, 0, 1), atol=tolerance))
