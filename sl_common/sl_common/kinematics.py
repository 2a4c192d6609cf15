"""Kinematics of a serial arm from its URDF, on pinocchio."""

from collections.abc import Sequence

import numpy as np
import pinocchio
from numpy.typing import ArrayLike, NDArray

from sl_common.errors import InvalidInputError, ModelError

Array = NDArray[np.float64]


class Kinematics:
    """Forward kinematics and Jacobian of the chain from a base to a tip frame.

    Only the joints of that chain count; other joints of the URDF (grippers, a second arm) stay at zero. Revolute,
    continuous and prismatic joints are supported; a continuous joint has infinite position limits.

    Attributes:
        base_frame: Name of the base frame.
        tip_frame: Name of the tip frame.
        joint_names: The chain's movable joints from base to tip.
        lower: (n,) lower position limits [rad or m].
        upper: (n,) upper position limits [rad or m].
        max_velocity: (n,) velocity limits of the URDF [rad/s or m/s]; infinite where it gives none.
    """

    def __init__(self, urdf_xml: str, base_frame: str, tip_frame: str) -> None:
        try:
            self._model = pinocchio.buildModelFromXML(urdf_xml)
        except Exception as error:  # pinocchio raises several types, none documented
            raise ModelError(f"robot_description is not a usable URDF: {error}") from None
        self._data = self._model.createData()
        self.base_frame, self.tip_frame = base_frame, tip_frame
        self._base, self._tip = self._frame(base_frame), self._frame(tip_frame)
        self._joints = self._chain()
        model = self._model
        self.joint_names: tuple[str, ...] = tuple(model.names[j] for j in self._joints)
        self._continuous = np.array([model.joints[j].nq == 2 for j in self._joints])
        self._q_index = np.array([model.joints[j].idx_q for j in self._joints])
        self._v_index = np.array([model.joints[j].idx_v for j in self._joints])
        limited = ~self._continuous
        self.lower = np.where(limited, model.lowerPositionLimit[self._q_index], -np.inf)
        self.upper = np.where(limited, model.upperPositionLimit[self._q_index], np.inf)
        velocity = model.upperVelocityLimit if hasattr(model, "upperVelocityLimit") else model.velocityLimit
        self.max_velocity = np.where(velocity[self._v_index] > 0, velocity[self._v_index], np.inf)

    def _frame(self, name: str) -> int:
        if not self._model.existFrame(name):
            known = ", ".join(sorted({f.name for f in self._model.frames} - {"universe"}))
            raise ModelError(f"frame '{name}' is not in robot_description; it has: {known}")
        return int(self._model.getFrameId(name))

    def _chain(self) -> list[int]:
        model = self._model
        base_joint = model.frames[self._base].parentJoint
        joints, joint = [], model.frames[self._tip].parentJoint
        while joint not in (base_joint, 0):
            if model.joints[joint].nv != 1:
                raise ModelError(
                    f"joint '{model.names[joint]}' has {model.joints[joint].nv} degrees of freedom, expected 1"
                )
            joints.append(joint)
            joint = model.parents[joint]
        if joint != base_joint:
            raise ModelError(
                f"frame '{self.tip_frame}' is not a descendant of '{self.base_frame}' in robot_description"
            )
        if not joints:
            raise ModelError(
                f"no movable joint between '{self.base_frame}' and '{self.tip_frame}' in robot_description"
            )
        return joints[::-1]

    @property
    def size(self) -> int:
        """Number of joints n."""
        return len(self.joint_names)

    def positions_from(self, names: Sequence[str], positions: Sequence[float] | Array) -> Array:
        """Pick this chain's positions (n,) by name out of a JointState's parallel arrays.

        Raises InvalidInputError for a missing joint, arrays of different length, or a value that is not finite.
        """
        if len(names) != len(positions):
            raise InvalidInputError(f"joint state has {len(names)} names but {len(positions)} positions")
        index = {name: i for i, name in enumerate(names)}
        missing = [name for name in self.joint_names if name not in index]
        if missing:
            raise InvalidInputError(
                f"joint state lacks {', '.join(missing)}; it has: {', '.join(names) or 'no joints'}"
            )
        q = np.array([positions[index[name]] for name in self.joint_names], dtype=np.float64)
        if not np.all(np.isfinite(q)):
            bad = [n for n, x in zip(self.joint_names, q, strict=True) if not np.isfinite(x)]
            raise InvalidInputError(f"joint state is not finite for {', '.join(bad)}")
        return q

    def forward(self, q: ArrayLike) -> Array:
        """Return base_from_tip (4, 4) [m] at joint positions q (n,)."""
        pinocchio.framesForwardKinematics(self._model, self._data, self._full(q))
        base_from_tip = self._data.oMf[self._base].actInv(self._data.oMf[self._tip])
        return np.array(base_from_tip.homogeneous)

    def jacobian(self, q: ArrayLike) -> Array:
        """Return the geometric Jacobian (6, n) of the tip at q (n,): linear, then angular, along the base's axes."""
        full = self._full(q)
        jacobian = pinocchio.computeFrameJacobian(
            self._model, self._data, full, self._tip, pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )[:, self._v_index]
        pinocchio.framesForwardKinematics(self._model, self._data, full)
        base_from_world = self._data.oMf[self._base].rotation.T
        return np.vstack([base_from_world @ jacobian[:3], base_from_world @ jacobian[3:]])

    def _full(self, q: ArrayLike) -> Array:
        q = np.asarray(q, dtype=np.float64)
        if q.shape != (self.size,):
            raise InvalidInputError(f"expected {self.size} joint positions, got shape {q.shape}")
        full = pinocchio.neutral(self._model)
        full[self._q_index] = np.where(self._continuous, np.cos(q), q)
        full[self._q_index[self._continuous] + 1] = np.sin(q[self._continuous])
        return full
