"""Parameters of the node calibrator."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rclpy.node import Node

from pattern_gen.gray_code import Arrangement
from sl_calibration.camera_calibration import CameraOptions
from sl_calibration.chessboard import Board, parse_size
from sl_calibration.intrinsics import MODELS
from sl_calibration.motion_plan import MotionPlanOptions
from sl_calibration.procedures.camera import CameraProcedure
from sl_calibration.procedures.colours import ColoursProcedure
from sl_calibration.procedures.hand_eye import HandEyeProcedure
from sl_calibration.procedures.procam import ProcamProcedure
from sl_calibration.procedures.procedure import Procedure
from sl_calibration.procedures.self_motion import SelfMotion
from sl_calibration.self_calibration.calibrate import SelfCalibrationOptions
from sl_calibration.self_calibration.noise_model import RobotNoise
from sl_common import transforms
from sl_common.errors import InvalidInputError
from sl_common.ros.parameters import declare

PROCEDURES = ("self", "camera", "procam", "hand_eye", "colours")


@dataclass(frozen=True)
class CalibratorParameters:
    """What the node was started with; lengths in metres, angles in radians."""

    procedure: Procedure
    calibration_folder: Path
    session_folder: Path
    base_frame: str
    flange_frame: str
    least_points: int
    max_joint_speed: float
    plan: MotionPlanOptions
    motion_duration: float
    motion_settle: float
    sample_timeout: float
    max_joint_gap: float
    joint_wait: float
    projection_settle: float


def _procedure(node: Node) -> Procedure:
    """Declare what the procedures are told, and make the one asked for."""
    name = declare(
        node,
        "procedure",
        "self",
        "What is calibrated: self, all from known robot motion without a grid; with a chessboard: camera, procam"
        " (camera and projector), hand_eye; colours, of the letters",
        choices=PROCEDURES,
    )
    size = declare(node, "board", "", "Inner corners of the chessboard, such as 9x7 (camera, procam, hand_eye)")
    square = declare(node, "square", 0.0, "Side of a square of the chessboard", unit="m", minimum=0.0)
    camera = CameraOptions(
        declare(node, "camera_model", "auto", "Distortion model of procedure camera", choices=("auto", *MODELS))
    )
    arrangement = declare(
        node,
        "gray_code_arrangement",
        "reflected",
        "Order of the code words of procedure procam: pattern_publisher's parameter of this name",
        choices=[a.value for a in Arrangement],
    )
    flange = declare(
        node,
        "flange",
        [0.0],
        "Pose x y z [m] qx qy qz qw of the flange in the base while procedure procam takes its samples, for"
        " projector_pose.yaml by the calibration folder's hand_eye.yaml; [0.0]: not known",
    )
    if len(flange) not in (1, 7):
        raise InvalidInputError(f"parameter flange has {len(flange)} numbers, expected x y z qx qy qz qw")
    colours = ColoursProcedure(
        intensity_chart=declare(node, "intensity_chart", False, "Project the intensity chart too (colours)"),
        adapt_to_scene=declare(
            node, "adapt_to_scene", False, "Choose letters for all coloured surfaces of the scene (colours)"
        ),
    )
    motion = SelfMotion(
        options=SelfCalibrationOptions(
            robot=RobotNoise(
                position=1e-3
                * declare(node, "position_noise", 0.1, "Noise of flange positions", unit="mm", minimum=1e-3),
                rotation=float(
                    np.radians(
                        declare(node, "rotation_noise", 0.02, "Noise of flange rotations", unit="deg", minimum=1e-4)
                    )
                ),
            ),
            refine_camera=declare(node, "refine_camera", False, "Estimate the camera's intrinsics too (self)"),
            left_out=declare(node, "left_out_errors", True, "Compute the errors of views left out as well (self)"),
        ),
        min_confidence=declare(
            node, "min_confidence", 0.9, "Dots of lower confidence are left out", minimum=0.0, maximum=1.0
        ),
        least_dots=declare(node, "least_dots", 60, "Fewest dots of a usable view", minimum=12),
    )
    if name == "self":
        return motion
    if name == "colours":
        return colours
    if not size or square <= 0:
        raise InvalidInputError(
            f"procedure {name} needs the chessboard: parameters board, such as 9x7 inner corners, and square, the side"
            f" of a square in metres; they are '{size}' and {square:g}"
        )
    board = Board(*parse_size(size, "board"), square)
    if name == "camera":
        return CameraProcedure(board=board, options=camera)
    if name == "procam":
        pose = transforms.from_quaternion(flange[:3], flange[3:]) if len(flange) == 7 else None
        return ProcamProcedure(board=board, arrangement=Arrangement(arrangement), base_from_flange=pose)
    return HandEyeProcedure(board=board)


def read(node: Node) -> CalibratorParameters:
    """Declare and read all parameters; raises InvalidInputError naming the one that is wrong."""
    procedure = _procedure(node)
    return CalibratorParameters(
        procedure=procedure,
        calibration_folder=Path(
            declare(node, "calibration_folder", "calibration", "Folder that ~/save writes and ~/load reads")
        ).expanduser(),
        session_folder=Path(
            declare(node, "session_folder", "calibration_session", "Folder that keeps the samples")
        ).expanduser(),
        base_frame=declare(node, "base_frame", "base_link", "Base frame of the robot"),
        flange_frame=declare(node, "flange_frame", "tool0", "Flange frame of the robot"),
        least_points=procedure.least_dots if isinstance(procedure, SelfMotion) else 1,
        max_joint_speed=declare(
            node, "max_joint_speed", 0.01, "A robot faster than this is not at rest", unit="rad/s", minimum=0.0
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
        projection_settle=declare(
            node,
            "projection_settle",
            0.2,
            "From the projector's acknowledgement of a frame to the first image that counts (procam, colours)",
            unit="s",
            minimum=0.0,
        ),
    )


def _radians(node: Node, name: str, default: float, description: str) -> float:
    return float(np.radians(declare(node, name, default, description, unit="deg", minimum=1.0, maximum=90.0)))
