# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is declared in several places agrees, and what is shipped can be built and found."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from importlib.metadata import distribution, requires
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory

import fden_ros

ROOT = Path(__file__).resolve().parents[1]
PROGRAMS = {entry.name for entry in distribution("fden_ros").entry_points}

# Distribution on the package index: the rosdep key that brings it.
ROSDEP_KEYS = {
    "filterpy": "python3-filterpy-pip",
    "hypothesis": "python3-hypothesis",
    "jinja2": "python3-jinja2",
    "lz4": "mcap-ros2-support",
    "matplotlib": "python3-matplotlib",
    "mcap": "mcap-ros2-support",
    "mcap-ros2-support": "mcap-ros2-support",
    "mpmath": "python3-sympy",
    "numpy": "python3-numpy",
    "pytest": "python3-pytest",
    "pytest-xdist": "python3-pytest-xdist",
    "pyyaml": "python3-yaml",
    "rich": "python3-rich",
    "ros-jazzy-domain-coordinator": "domain_coordinator",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "zstandard": "mcap-ros2-support",
}
IMPORT_NAMES = {"mcap-ros2-support": "mcap_ros2", "pyyaml": "yaml"}


def manifest(path: str = "package.xml") -> ElementTree.Element:
    return ElementTree.parse(ROOT / path).getroot()


def dependencies(kind: str) -> set[str]:
    return {element.text or "" for element in manifest().iter(kind)}


def requirements(extra: str | None = None) -> set[str]:
    """Return the names of the distributions that setup.py asks for, in an extra or plainly."""
    names = set()
    for requirement in requires("fden_ros") or []:
        name, _, marker = requirement.partition(";")
        found = re.search(r"extra == ['\"](\w+)['\"]", marker)
        if (found.group(1) if found else None) == extra:
            names.add(re.split(r"[<>=!~ ]", name, maxsplit=1)[0].lower())
    return names - {"setuptools"}


def imports_of(path: Path) -> set[str]:
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


def imported_modules(*folders: str) -> set[str]:
    names = set().union(*(imports_of(p) for f in folders for p in (ROOT / f).rglob("*.py")))
    return {name.split(".")[0] for name in names} - set(sys.stdlib_module_names) - {"fden_ros"}


def run(*command: str | Path, **options: object) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, **options
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def test_the_version_is_the_same_everywhere():
    setup_version = re.search(r'version="([^"]+)"', (ROOT / "setup.py").read_text())
    assert setup_version is not None
    assert {
        setup_version.group(1),
        manifest().findtext("version"),
        manifest("msg_defs/package.xml").findtext("version"),
    } == {fden_ros.__version__}


def test_package_xml_and_setup_py_ask_for_the_same_python_packages():
    assert {ROSDEP_KEYS[name] for name in requirements()} <= dependencies("exec_depend")
    assert {ROSDEP_KEYS[name] for name in requirements("test")} <= dependencies("test_depend")
    python_keys = {
        key
        for key in dependencies("exec_depend") | dependencies("test_depend")
        if key.startswith(("python3-", "mcap"))
    }
    assert python_keys <= {ROSDEP_KEYS[n] for n in requirements() | requirements("test")}


def test_every_import_is_declared():
    declared = requirements() | requirements("batch")
    python = {IMPORT_NAMES.get(name, name) for name in declared}
    ros = {key for key in dependencies("exec_depend") if "-" not in key}
    assert imported_modules("fden_ros", "launch") <= python | ros


def test_the_core_and_the_simulation_know_no_ros_and_not_each_other():
    ros = {key for key in dependencies("exec_depend") if "-" not in key}
    assert not imported_modules("fden_ros/core", "fden_ros/simulation") & ros - {"simulation"}
    for one, other in (("core", "simulation"), ("simulation", "core")):
        for path in (ROOT / "fden_ros" / one).rglob("*.py"):
            assert not [name for name in imports_of(path) if name.startswith(f"fden_ros.{other}")]
    for path in (ROOT / "simulation").glob("*.py"):
        assert not [name for name in imports_of(path) if name.startswith("fden_ros.core")]


def test_importing_the_core_imports_none_of_what_it_computes_with():
    code = (
        "import sys, fden_ros.core; print(sorted({'numpy', 'scipy', 'rclpy'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout == "[]\n", result.stderr


def test_a_command_in_the_environment_keeps_dds_on_this_host_unless_told_otherwise(tmp_path):
    show = (ROOT / "scripts" / "ros_env", "printenv", "ROS_AUTOMATIC_DISCOVERY_RANGE")
    fresh = {key: value for key, value in os.environ.items() if not key.startswith("ROS_AUTO")}
    assert run(*show, env=fresh, cwd=tmp_path).stdout == "LOCALHOST\n"
    fresh["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
    assert run(*show, env=fresh, cwd=tmp_path).stdout == "SUBNET\n"


def test_ros_finds_the_launch_files_and_every_program_in_this_environment():
    # As ros2 launch and ros2 run look: down the folders, through no link to one.
    share, prefix = get_package_share_directory("fden_ros"), get_package_prefix("fden_ros")
    names = {name for _, _, files in os.walk(share) for name in files}
    assert {path.name for path in (ROOT / "launch").glob("*.launch.py")} <= names
    programs = {
        path.name for path in Path(prefix, "lib", "fden_ros").iterdir() if os.access(path, os.X_OK)
    }
    assert programs == PROGRAMS


def test_colcon_builds_the_package_into_a_workspace_that_ros_finds(tmp_path):
    """The set-up has built the messages so already."""
    install = tmp_path / "install"
    run(
        "colcon", "--log-base", tmp_path / "log", "build",
        "--base-paths", ROOT,
        "--build-base", tmp_path / "build", "--install-base", install,
        cwd=tmp_path,
    )  # fmt: skip
    for program in PROGRAMS:
        assert os.access(install / "fden_ros" / "lib" / "fden_ros" / program, os.X_OK)
    share = install / "fden_ros" / "share"
    assert (share / "ament_index/resource_index/packages/fden_ros").is_file()
    for folder, pattern in (("launch", "*.launch.py"), ("config", "*.*"), ("bags", "*.yaml")):
        shipped = {path.name for path in (share / "fden_ros" / folder).glob(pattern)}
        assert shipped == {path.name for path in (ROOT / folder).glob(pattern)} != set()

    sourced = f"source {install}/local_setup.bash && cd {tmp_path} && "
    code = "import fden_msgs; from fden_ros.core.estimation import loops; print(loops._COMPILED)"
    assert f"'{install}/" in run("bash", "-c", f"{sourced}python -c '{code}'").stdout
    fden = install / "fden_ros" / "lib" / "fden_ros" / "fden"
    assert run("bash", "-c", f"{sourced}{fden} --version").stdout.startswith("fden ")


@pytest.mark.parametrize("module", ["fden_ros.nodes.identifier", "fden_ros.cli"])
@pytest.mark.parametrize("given", [None, "3"])
def test_a_process_keeps_linear_algebra_on_one_thread_unless_told_otherwise(module, given):
    environment = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    if given is not None:
        environment["OPENBLAS_NUM_THREADS"] = given
    script = f"import os, {module}; print(os.environ['OPENBLAS_NUM_THREADS'])"
    done = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == (given or "1")
