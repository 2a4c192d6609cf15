"""Parameters of the node calibrator."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rclpy.node import Node

from sl_calibration.motion_plan import MotionPlanOptions
from sl_calibration.nodes.sampling import SamplingLimits
from sl_calibration.self_calibration.noise_model import RobotNoise
from sl_common.ros.parameters import declare


@dataclass(frozen=True)
class CalibratorParameters:
    """What the node was started with; lengths in metres, angles in radians."""

    procedure: str
    calibration_folder: Path
    session_folder: Path
    base_frame: str
    flange_frame: str
    robot_noise: RobotNoise
    refine_camera: bool
    left_out_errors: bool
    limits: SamplingLimits
    plan: MotionPlanOptions
    motion_duration: float
    motion_settle: float
    sample_timeout: float
    max_joint_gap: float
    joint_wait: float


def read(node: Node) -> CalibratorParameters:
    """Declare and read all parameters; raises InvalidInputError naming the one that is wrong."""
    return CalibratorParameters(
        procedure=declare(
            node,
            "procedure",
            "self",
            "What is calibrated: self, from known robot motion without a grid",
            choices=("self",),
        ),
        calibration_folder=Path(
            declare(node, "calibration_folder", "calibration", "Folder that ~/save writes and ~/load reads")
        ).expanduser(),
        session_folder=Path(
            declare(node, "session_folder", "calibration_session", "Folder that keeps the samples")
        ).expanduser(),
        base_frame=declare(node, "base_frame", "base_link", "Base frame of the robot"),
        flange_frame=declare(node, "flange_frame", "tool0", "Flange frame of the robot"),
        robot_noise=RobotNoise(
            position=1e-3 * declare(node, "position_noise", 0.1, "Noise of flange positions", unit="mm", minimum=1e-3),
            rotation=float(
                np.radians(declare(node, "rotation_noise", 0.02, "Noise of flange rotations", unit="deg", minimum=1e-4))
            ),
        ),
        refine_camera=declare(node, "refine_camera", False, "Estimate the camera's intrinsics too"),
        left_out_errors=declare(node, "left_out_errors", True, "Compute the errors of views left out as well"),
        limits=SamplingLimits(
            min_confidence=declare(
                node, "min_confidence", 0.9, "Dots of lower confidence are left out", minimum=0.0, maximum=1.0
            ),
            least_dots=declare(node, "least_dots", 60, "Fewest dots of a usable view", minimum=12),
            max_joint_speed=declare(
                node, "max_joint_speed", 0.01, "A robot faster than this is not at rest", unit="rad/s", minimum=0.0
            ),
        ),
        plan=MotionPlanOptions(
            tilt=_radians(node, "motion_tilt", 22.0, "Largest tilt of the line of sight in ~/run_motion"),
            roll=_radians(node, "motion_roll", 60.0, "Largest roll about the line of sight in ~/run_motion"),
        ),
        motion_duration=declare(node, "motion_duration", 2.0, "Time of each motion, at least", unit="s", minimum=0.0),
        motion_settle=declare(node, "motion_settle", 0.3, "Rest before a sample", unit="s", minimum=0.01),
        sample_timeout=declare(
            node, "sample_timeout", 5.0, "Longest wait for a usable view in ~/run_motion", unit="s", minimum=0.1
        ),
        max_joint_gap=declare(
            node, "max_joint_gap", 0.1, "Joint states farther apart are not interpolated", unit="s", minimum=0.001
        ),
        joint_wait=declare(
            node, "joint_wait", 0.1, "How long to wait for the joint state after an image", unit="s", minimum=0.0
        ),
    )


def _radians(node: Node, name: str, default: float, description: str) -> float:
    return float(np.radians(declare(node, name, default, description, unit="deg", minimum=1.0, maximum=90.0)))
