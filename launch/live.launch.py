# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Start simulator, identifier and force controller: the whole system without a robot.

ros2 launch fden_ros live.launch.py
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    arguments = [
        DeclareLaunchArgument(
            "parameters",
            default_value=PathJoinSubstitution(
                [FindPackageShare("fden_ros"), "config", "tissue_simulator.yaml"]
            ),
            description="YAML file with the parameters of the three nodes.",
        ),
        DeclareLaunchArgument(
            "namespace", default_value="", description="Namespace of the nodes and their topics."
        ),
        DeclareLaunchArgument(
            "scheduled",
            default_value="true",
            choices=["true", "false"],
            description="Gains by the live stiffness; false: fixed gains.",
        ),
    ]
    common = {
        "package": "fden_ros",
        "namespace": LaunchConfiguration("namespace"),
        # Not below `parameters`, where a file that is not there is passed over.
        "arguments": ["--ros-args", "--params-file", LaunchConfiguration("parameters")],
    }
    scheduled = ParameterValue(LaunchConfiguration("scheduled"), value_type=bool)
    return LaunchDescription(
        [
            *arguments,
            Node(
                executable="tissue_simulator",
                name="tissue_simulator",
                **common,
            ),
            LifecycleNode(
                executable="identifier",
                name="identifier",
                parameters=[{"autostart": True}],
                output="screen",
                **common,
            ),
            Node(
                executable="force_controller",
                name="force_controller",
                parameters=[{"scheduled": scheduled}],
                output="screen",
                **common,
            ),
        ]
    )
