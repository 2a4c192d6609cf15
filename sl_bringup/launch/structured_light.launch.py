"""A real cell: the chain's nodes, on the topics of a camera driver and of ur_robot_driver.

    ros2 launch sl_bringup structured_light.launch.py calibration_folder:=/home/me/calibration image:=/camera/image_raw

The projector shows the topic projector/image in full screen (for example with image_view on the projector's display).
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node, SetRemap
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = [
    (
        "calibration_folder",
        "calibration",
        "folder with camera.yaml, projector.yaml, hand_eye.yaml, projector_pose.yaml",
    ),
    ("pattern_file", "", "pattern to project; empty: the shipped one"),
    ("image", "camera/image_raw", "the camera driver's image topic"),
    ("camera_info", "camera/camera_info", "the camera driver's camera_info topic"),
    ("joint_states", "/joint_states", "the robot driver's joint states"),
    ("robot_description", "/robot_description", "the robot's URDF, latched"),
    ("base_frame", "base_link", "base frame of the robot"),
    ("flange_frame", "tool0", "frame that carries the camera"),
    ("command_interface", "forward_position", "forward_position or joint_trajectory"),
    ("commands", "/forward_position_controller/commands", "setpoints, for forward_position"),
    ("joint_trajectory", "/scaled_joint_trajectory_controller/joint_trajectory", "for joint_trajectory"),
    ("calibrate", "true", "start the calibrator as well"),
    ("rviz", "false", "start RViz with the shipped layout"),
]


def generate_launch_description() -> LaunchDescription:
    share = FindPackageShare("sl_bringup")

    def value(name: str) -> LaunchConfiguration:
        return LaunchConfiguration(name)

    def node(package: str, name: str, *parameters: dict, **options: object) -> Node:
        file = PathJoinSubstitution([share, "config", f"{name}.yaml"])
        return Node(
            package=package, executable=name, name=name, output="screen", parameters=[file, *parameters], **options
        )

    frames = {"base_frame": value("base_frame"), "flange_frame": value("flange_frame")}
    folder = {"calibration_folder": value("calibration_folder")}
    remaps = [
        SetRemap(topic, value(argument))
        for topic, argument in (
            ("camera/image_raw", "image"),
            ("camera/camera_info", "camera_info"),
            ("joint_states", "joint_states"),
            ("robot_description", "robot_description"),
            ("commands", "commands"),
            ("joint_trajectory", "joint_trajectory"),
        )
    ]
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=text)
                for name, default, text in ARGUMENTS
            ),
            *remaps,
            node("pattern_gen", "pattern_publisher", {"pattern_file": value("pattern_file")}),
            node("sl_decoder", "decoder"),
            node("sl_calibration", "triangulator", folder, frames),
            node("sl_calibration", "calibrator", folder, frames, condition=IfCondition(value("calibrate"))),
            node("arm_positioner", "positioner", folder, frames, {"command_interface": value("command_interface")}),
            Node(
                package="rviz2",
                executable="rviz2",
                arguments=["-d", PathJoinSubstitution([share, "rviz", "structured_light.rviz"])],
                condition=IfCondition(value("rviz")),
            ),
        ]
    )
