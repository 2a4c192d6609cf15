"""The arm as its joint states show it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from arm_positioner.measurement import MeasuredJoints
from arm_positioner.singularity import Conditioning
from sl_common import transforms
from sl_common.kinematics import Kinematics

Array = NDArray[np.float64]


class MeasuredArm:
    """Camera pose and condition number at the newest joint state.

    Attributes:
        joints: The joint states of the last moments.
        conditioning: Condition numbers of the arm.
        flange_from_camera: (4, 4) hand-eye transform [m].
    """

    def __init__(self, kinematics: Kinematics, *, rest_motion: float) -> None:
        """Use ``kinematics``, not shared with another thread."""
        self._kinematics = kinematics
        self.conditioning = Conditioning(kinematics)
        self.joints = MeasuredJoints(rest_motion=rest_motion)
        self.flange_from_camera = transforms.identity()

    def positions_from(self, names: Sequence[str], positions: Sequence[float]) -> Array:
        """Return the arm's positions (n,) out of a joint state; see :meth:`Kinematics.positions_from`."""
        return self._kinematics.positions_from(names, positions)

    def camera_pose(self) -> Array | None:
        """Return base_from_camera (4, 4) [m]; None: no joint state yet."""
        if self.joints.newest is None:
            return None
        return self._kinematics.forward(self.joints.newest) @ self.flange_from_camera

    def condition(self, position: Array | None = None) -> float:
        """Return the condition number at joint positions (n,), or at the newest ones; NaN: none yet."""
        position = self.joints.newest if position is None else position
        return float("nan") if position is None else self.conditioning.at(position)

    def error(self, target: Array) -> tuple[float, float]:
        """Return the distance [m] and angle [rad] from the camera to a pose (4, 4); NaN: not known."""
        pose = self.camera_pose()
        if pose is None:
            return float("nan"), float("nan")
        delta = transforms.difference(pose, target)
        return float(np.linalg.norm(delta[:3])), float(np.linalg.norm(delta[3:]))
