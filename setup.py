# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Package description for pip and for colcon (ament_python)."""

import xml.etree.ElementTree as ElementTree
from glob import glob

from setuptools import find_packages, setup

CLUSTER = [
    "distributed",
    "fsspec[http]",
    "pyarrow",
    "s3fs",
    "sshfs",
    "universal-pathlib>=0.3",
]

setup(
    name="fden_ros",
    version=ElementTree.parse("package.xml").findtext("version"),
    description="Online identification of soft-tissue stiffness with the FDEN model, for ROS 2",
    license="Apache-2.0",
    maintainer="fden_ros maintainers",
    maintainer_email="maintainers@fden.example",
    python_requires=">=3.10",
    packages=find_packages(include=["fden_ros", "fden_ros.*"]),
    package_data={"fden_ros": ["py.typed", "*.yaml", "*/*.yaml", "report/*.html"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/fden_ros"]),
        ("share/fden_ros", ["package.xml"]),
        ("share/fden_ros/launch", sorted(glob("launch/*.launch.py"))),
        ("share/fden_ros/config", sorted(glob("config/*.*"))),
        ("share/fden_ros/config/priors", sorted(glob("config/priors/*.*"))),
        ("share/fden_ros/config/robots", sorted(glob("config/robots/*.yaml"))),
        ("share/fden_ros/bags", sorted(glob("bags/*.yaml"))),
    ],
    zip_safe=False,
    # The lower bounds are what Ubuntu 24.04, the platform of ROS 2 Jazzy, has.
    install_requires=[
        "Jinja2>=3.1",
        "PyYAML>=6.0",
        "argcomplete>=3.1",
        "filterpy>=1.4.5",
        "matplotlib>=3.6",
        "mcap>=1.1",
        "numpy>=1.26",
        "rich>=13.7",
        "rosbags>=0.11",
        "scipy>=1.11",
        "setuptools",
        "threadpoolctl>=3.1",
    ],
    extras_require={
        # ROS 2 itself, where no distribution of it is installed. Never a plain requirement: on a
        # robot pip would put a second ROS beside the first.
        "wheels": [
            "ros-jazzy-ament-index-python",
            "ros-jazzy-common-interfaces",
            "ros-jazzy-rclpy",
            "ros-jazzy-rmw-fastrtps-cpp",
            "ros-jazzy-rosidl-parser",
        ],
        # fden batch --scheduler and -o FILE.parquet; recordings at s3://, https://, sftp://.
        "cluster": CLUSTER,
        "test": [
            *CLUSTER,
            "flask-cors",  # of moto's server
            "hypothesis",
            "moto[s3]",
            "pytest",
            "pytest-xdist",
            "ros-jazzy-domain-coordinator",
        ],
        "lint": ["mypy", "ruff"],
    },
    entry_points={
        "console_scripts": [
            "fden = fden_ros.cli:program",
            "identifier = fden_ros.nodes.programs:identifier",
            "tissue_simulator = fden_ros.nodes.programs:tissue_simulator",
            "force_controller = fden_ros.nodes.programs:force_controller",
        ]
    },
)
