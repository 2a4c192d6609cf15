"""The positioner's parameters."""

from dataclasses import dataclass

from rclpy.node import Node

from arm_positioner import limits
from arm_positioner.errors import InvalidGoalError
from arm_positioner.limits import JointLimits
from arm_positioner.singularity import SingularityThresholds
from arm_positioner.surface import FitOptions
from arm_positioner.target import TargetOptions
from arm_positioner.watchdog import WatchOptions
from sl_common.kinematics import Kinematics
from sl_common.ros.parameters import declare

FORWARD_POSITION, JOINT_TRAJECTORY = "forward_position", "joint_trajectory"


@dataclass(frozen=True)
class Settings:
    """All parameters, checked."""

    joints: tuple[str, ...]
    base_frame: str
    flange_frame: str
    camera_frame: str
    calibration_folder: str
    command_interface: str
    period: float
    lookahead: float
    velocity_scale: float
    max_velocity: tuple[float, ...]
    max_acceleration: tuple[float, ...]
    max_jerk: tuple[float, ...]
    joint_margin: float
    duration: float
    goal_timeout: float
    refinements: int
    follow_smoothing: float
    free_roll: bool
    doubtful_normal_sigma: float
    target: TargetOptions
    watch: WatchOptions


def read(node: Node) -> Settings:
    """Declare and read all parameters; raises StructuredLightError for one that cannot be used."""

    def number(name: str, default: float, text: str, unit: str, low: float = 0.0, high: float | None = None) -> float:
        return declare(node, name, default, text, unit=unit, minimum=low, maximum=high)

    def per_joint(name: str, default: list[float], text: str) -> tuple[float, ...]:
        return tuple(declare(node, name, default, text, unit="one number or one per joint", minimum=1e-6))

    joints = declare(node, "joints", [""], "joints in the order of the command; [''] for the order of the arm")
    interface = declare(
        node,
        "command_interface",
        FORWARD_POSITION,
        "forward_position: Float64MultiArray on 'commands'; joint_trajectory: JointTrajectory on 'joint_trajectory'",
        choices=(FORWARD_POSITION, JOINT_TRAJECTORY),
    )
    text = "singularity: condition number of the Jacobian, lengths in units of the arm's own"
    thresholds = SingularityThresholds(
        slow=number("condition_slow", 40.0, f"{text} past which the arm slows down", "1", 1.0),
        stop=number("condition_stop", 100.0, f"{text} past which it stops", "1", 1.0),
    )
    if not thresholds.slow < thresholds.stop:
        raise InvalidGoalError(
            f"parameter condition_slow {thresholds.slow:g} must be below condition_stop {thresholds.stop:g}"
        )
    free_roll, roll = _roll(node)
    return Settings(
        joints=tuple(j for j in joints if j),
        base_frame=declare(node, "base_frame", "base_link", "frame of goals, targets and status"),
        flange_frame=declare(node, "flange_frame", "tool0", "frame that carries the camera"),
        camera_frame=declare(node, "camera_frame", "camera_optical_frame", "the camera's optical frame"),
        calibration_folder=declare(
            node, "calibration_folder", "", "folder with hand_eye.yaml; read again when it changes"
        ),
        command_interface=interface,
        period=1.0 / number("rate", 125.0, "setpoints per second", "1/s", 10.0, 1000.0),
        lookahead=number("lookahead", 0.2, "joint_trajectory: motion sent ahead, a stop behind it", "s", 0.02, 2.0),
        velocity_scale=number("velocity_scale", 0.5, "share of the URDF's velocity limits in use", "1", 0.01, 1.0),
        max_velocity=per_joint("max_velocity", [3.0], "velocity limit [rad/s or m/s]; the URDF's holds too"),
        max_acceleration=per_joint("max_acceleration", [2.5], "acceleration limit [rad/s^2 or m/s^2]"),
        max_jerk=per_joint("max_jerk", [25.0], "jerk limit [rad/s^3 or m/s^3]"),
        joint_margin=number("joint_margin", 0.02, "distance of goals from the joints' position limits", "rad or m"),
        duration=number(
            "duration", 0.0, "of a motion whose goal gives none; 0: as fast as the limits allow", "s", 0.0, 600.0
        ),
        goal_timeout=number("goal_timeout", 3.0, "time to wait for a cloud, or for the arm to rest", "s", 0.0, 60.0),
        refinements=declare(
            node,
            "refinements",
            1,
            "further looks at the object, and corrections, once in front of it",
            minimum=0,
            maximum=10,
        ),
        follow_smoothing=number("follow_smoothing", 0.15, "memory of the filter on a followed target", "s", 0.0, 5.0),
        free_roll=free_roll,
        doubtful_normal_sigma=number(
            "doubtful_normal_sigma", 0.01, "uncertainty of the normal past which the result warns", "rad", 1e-6
        ),
        target=TargetOptions(
            standoff=number("standoff", 0.3, "distance of the camera from the surface", "m", 0.01, 10.0),
            roll=roll,
            min_confidence=number("min_confidence", 0.0, "points below it are ignored", "1", 0.0, 1.0),
            min_object_points=declare(
                node, "min_object_points", 20, "patches with fewer points are no objects", minimum=6
            ),
            max_jump=number("max_jump", 0.1, "distance past which a patch is not the object seen before", "m", 1e-3),
            fit=FitOptions(
                max_rms=number(
                    "max_fit_rms", 0.005, "RMS of the surface fit past which no target is derived", "m", 1e-6
                ),
                max_normal_sigma=number(
                    "max_normal_sigma", 0.05, "uncertainty of the normal past which no target is derived", "rad", 1e-6
                ),
                place_sigma=number(
                    "place_sigma", 0.0005, "error that all points have in common, such as the calibration's", "m"
                ),
            ),
        ),
        watch=WatchOptions(
            joint_timeout=number("joint_timeout", 0.1, "age of joint states past which the arm stops", "s", 0.005),
            target_timeout=number("target_timeout", 0.1, "age of ~/target_pose past which it is refused", "s", 0.005),
            cloud_timeout=number(
                "cloud_timeout", 1.0, "time without a usable cloud past which the arm stops", "s", 0.01
            ),
            lost_timeout=number(
                "lost_timeout", 5.0, "time at rest without cause removed before a goal is aborted", "s"
            ),
            deviation=number(
                "max_deviation", 0.05, "distance of measured joints from their setpoints", "rad or m", 1e-5
            ),
            driver_lag=number("driver_lag", 0.25, "longest delay of the driver", "s", 0.0, 2.0),
            settle_timeout=number("settle_timeout", 2.0, "time to arrive after the last setpoint", "s", 0.05, 60.0),
            position_tolerance=number("position_tolerance", 0.001, "of a target reached", "m", 1e-6),
            orientation_tolerance=number("orientation_tolerance", 0.005, "of a target reached", "rad", 1e-6),
            thresholds=thresholds,
        ),
    )


def joint_limits(arm: Kinematics, settings: Settings) -> JointLimits:
    """Return the limits of an arm that the parameters leave of its URDF's; raises InvalidGoalError for bad ones."""
    return limits.from_urdf(
        arm.joint_names,
        arm.lower,
        arm.upper,
        arm.max_velocity,
        velocity_scale=settings.velocity_scale,
        max_velocity=settings.max_velocity,
        max_acceleration=settings.max_acceleration,
        max_jerk=settings.max_jerk,
    )


def _roll(node: Node) -> tuple[bool, float | None]:
    """Return whether the roll may be chosen for the arm's sake, and the roll where it is fixed."""
    mode = declare(
        node,
        "roll_mode",
        "free",
        "free: turn the camera as little as possible, more to keep clear of singularities and joint limits; "
        "least_rotation: as little as possible; fixed: parameter roll",
        choices=("free", "least_rotation", "fixed"),
    )
    roll = declare(
        node, "roll", 0.0, "angle of the image about the optical axis, 0 upright (roll_mode fixed)", unit="rad"
    )
    return mode == "free", roll if mode == "fixed" else None
