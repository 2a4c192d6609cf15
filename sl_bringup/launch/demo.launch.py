"""The chain on the simulated cell, to watch in RViz; `ros2 run sl_bringup demo` is the one that measures.

ros2 launch sl_bringup demo.launch.py scene:=wavy rviz:=true
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    share = FindPackageShare("sl_bringup")
    arguments = [
        DeclareLaunchArgument("scene", default_value="wavy", description="scene in front of the arm"),
        DeclareLaunchArgument("seed", default_value="0", description="varies scene, mounting and noise"),
        DeclareLaunchArgument("calibration_folder", default_value="calibration", description="read and written"),
        DeclareLaunchArgument("rviz", default_value="false", description="start RViz with the shipped layout"),
    ]
    cell = Node(
        package="sl_sim",
        executable="cell",
        name="cell",
        output="screen",
        parameters=[
            PathJoinSubstitution([share, "config", "cell.yaml"]),
            {
                "scene": LaunchConfiguration("scene"),
                "seed": ParameterValue(LaunchConfiguration("seed"), value_type=int),
            },
        ],
    )
    chain = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(PathJoinSubstitution([share, "launch", "structured_light.launch.py"])),
        launch_arguments={
            "calibration_folder": LaunchConfiguration("calibration_folder"),
            "joint_states": "joint_states",
            "robot_description": "robot_description",
            "commands": "commands",
            "joint_trajectory": "joint_trajectory",
            "rviz": LaunchConfiguration("rviz"),
        }.items(),
    )
    return LaunchDescription([*arguments, cell, chain])
