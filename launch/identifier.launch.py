# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

r"""Start the identifier node with its parameter file, topics and lifecycle.

ros2 launch fden_ros identifier.launch.py force_topic:=/ft/wrench \
    displacement_topic:=/arm/joint_states
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from fden_ros.parameters import live_topics, read_parameter_file


def _check_parameters(context: LaunchContext) -> None:
    """Refuse a wrong parameter file here, not for ever by `respawn`; take its topics."""
    path, namespace = (
        LaunchConfiguration(name).perform(context) for name in ("parameters", "namespace")
    )
    read_parameter_file(path, f"{namespace}/identifier")
    # Topics that `fden configure` has written into the file, unless an argument names others.
    for what, topic in live_topics(path).items():
        name = f"{what}_topic"
        if context.launch_configurations.get(name) == what:
            context.launch_configurations[name] = topic


def generate_launch_description() -> LaunchDescription:
    arguments = [
        DeclareLaunchArgument(
            "parameters",
            default_value=PathJoinSubstitution(
                [FindPackageShare("fden_ros"), "config", "identifier.yaml"]
            ),
            description="YAML file with the node's parameters.",
        ),
        DeclareLaunchArgument(
            "namespace", default_value="", description="Namespace of the node and of its topics."
        ),
        DeclareLaunchArgument(
            "force_topic", default_value="force", description="Topic of the measured force."
        ),
        DeclareLaunchArgument(
            "displacement_topic",
            default_value="displacement",
            description="Topic of the measured displacement of the probe.",
        ),
        DeclareLaunchArgument(
            "autostart",
            default_value="true",
            choices=["true", "false"],
            description="Configure and activate the node at its start; false: a manager does.",
        ),
        DeclareLaunchArgument(
            "use_sim_time",
            default_value="false",
            choices=["true", "false"],
            description="Take the time from the topic /clock, as while a bag plays.",
        ),
        DeclareLaunchArgument(
            "respawn",
            default_value="false",
            choices=["true", "false"],
            description="Start the node again, 2 s after it has ended.",
        ),
        DeclareLaunchArgument(
            "log_level",
            default_value="info",
            choices=["debug", "info", "warn", "error", "fatal"],
            description="Least severity of the node's messages that is shown.",
        ),
    ]
    identifier = LifecycleNode(
        package="fden_ros",
        executable="identifier",
        name="identifier",
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        respawn=LaunchConfiguration("respawn"),
        respawn_delay=2.0,
        parameters=[
            {
                name: ParameterValue(LaunchConfiguration(name), value_type=bool)
                for name in ("autostart", "use_sim_time")
            },
        ],
        remappings=[
            ("force", LaunchConfiguration("force_topic")),
            ("displacement", LaunchConfiguration("displacement_topic")),
        ],
        arguments=[
            "--ros-args",
            "--log-level",
            LaunchConfiguration("log_level"),
            # Not below `parameters`, where a file that is not there is passed over.
            "--params-file",
            LaunchConfiguration("parameters"),
        ],
    )
    return LaunchDescription([*arguments, OpaqueFunction(function=_check_parameters), identifier])
