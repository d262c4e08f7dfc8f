# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What is declared in several places agrees, the layout holds, what is shipped can be built."""

from __future__ import annotations

import ast
import contextlib
import functools
import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from importlib.metadata import distribution, requires
from pathlib import Path
from typing import Any

import pytest
from fault_helpers import arm, first_press, write_bag
from rclpy.node import NodeNameNonExistentError
from ros_helpers import Bench, identifier

import fden_ros
from fden_ros.errors import InputError
from fden_ros.parameters import read_parameter_file
from fden_ros.tissues.library import load_library

ROOT = Path(__file__).resolve().parents[1]
PROGRAMS = {entry.name for entry in distribution("fden_ros").entry_points}

# Distribution on the package index: the rosdep key that brings it.
ROSDEP_KEYS = {
    "argcomplete": "python3-argcomplete",
    "filterpy": "python3-filterpy-pip",
    "jinja2": "python3-jinja2",
    "matplotlib": "python3-matplotlib",
    "mcap": "mcap-ros2-support",
    "numpy": "python3-numpy",
    "pyyaml": "python3-yaml",
    "rich": "python3-rich",
    "rosbags": "python3-rosbags-pip",
    "scipy": "python3-scipy",
    "threadpoolctl": "python3-sklearn",
}
IMPORT_NAMES = {"pyyaml": "yaml", "universal-pathlib": "upath"}


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
            names.add(re.split(r"[\[<>=!~ ]", name, maxsplit=1)[0].lower())
    return names - {"setuptools"}


@functools.cache
def imports_of(path: Path) -> tuple[tuple[str, str], ...]:
    """Each module that a file imports from, with the name; empty: as a whole."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found += [(node.module or "", alias.name) for alias in node.names]
    return tuple(found)


def imported_modules(*folders: str) -> set[str]:
    paths = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    names = {module.split(".")[0] for path in paths for module, _ in imports_of(path)}
    return names - set(sys.stdlib_module_names) - {"fden_ros"}


def run(*command: str | Path, **options: object) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, **options
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def test_the_version_is_the_same_everywhere():
    """That of package.xml: setup.py reads it, and the package asks what is installed."""
    version = manifest().findtext("version")
    assert version == manifest("msg_defs/package.xml").findtext("version") == fden_ros.__version__
    for path in ("CHANGELOG.rst", "msg_defs/CHANGELOG.rst"):
        assert f"\n{version} (" in (ROOT / path).read_text()


def test_package_xml_and_setup_py_ask_for_the_same_python_packages():
    assert {ROSDEP_KEYS[name] for name in requirements()} <= dependencies("exec_depend")


def test_every_import_is_declared_and_the_core_imports_no_ros():
    declared = requirements() | requirements("cluster")
    python = {IMPORT_NAMES.get(name, name) for name in declared}
    ros = {key for key in dependencies("exec_depend") if "-" not in key}
    # pandas: where the user has it, for a table of results.
    assert imported_modules("fden_ros", "launch") <= python | ros | {"pandas"}
    # The core and the simulation know no ROS.
    assert not imported_modules("fden_ros/core", "fden_ros/simulation") & ros - {"simulation"}


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
    code = "import fden_msgs, fden_ros; print([fden_ros.__file__])"
    assert f"'{install}/" in run("bash", "-c", f"{sourced}python -c '{code}'").stdout
    fden = install / "fden_ros" / "lib" / "fden_ros" / "fden"
    assert run("bash", "-c", f"{sourced}{fden} --version").stdout.startswith("fden ")


PRESS = ("examples/press.csv", "--config", "examples/probe.yaml")
POSE = "bags/golden/golden_pose"
ARM = ("{arm}", "--config", "{arm}/identifier.yaml")


OFFLINE = [
    ("replay", *ARM, "--json"),
    ("configure", POSE),
    ("batch", *ARM, "-o", "{new}/table.csv"),
    ("fit", "relaxation", "{new}/relaxation.csv", "--strain", "0.1"),
]


def test_offline_commands_need_no_ros_and_give_the_same_without(arm_bag, tmp_path):
    said = []
    ros = [key for key in dependencies("exec_depend") if "-" not in key]
    blocked = f"import sys; sys.modules.update(dict.fromkeys({ros}))"
    for begin in ("import sys", blocked):
        new = tmp_path / str(len(said))
        new.mkdir()
        rows = [f"{t},{500.0 * t**-0.1}" for t in (1, 2, 4, 8, 16, 32)]
        (new / "relaxation.csv").write_text("\n".join(["time_s,stress_pa", *rows]))
        words = [[word.format(arm=arm_bag, new=new) for word in one] for one in OFFLINE]
        code = f"{begin}; from fden_ros.cli import main\nfor one in {words}: assert main(one) == 0"
        shown = run(sys.executable, "-c", code, cwd=ROOT).stdout.replace(str(new), "")
        said.append([shown, *(path.read_text() for path in sorted(new.glob("table*.csv")))])
    assert said[0] == said[1] and said[0][0].count("relaxation") >= 1


@pytest.fixture(scope="module")
def arm_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("arm") / "bag", arm(first_press()))


def test_what_needs_ros_says_so_in_one_line_without():
    code = "import subprocess, sys; sys.modules['rclpy'] = subprocess.Popen = None; "
    code += "from fden_ros import cli; from fden_ros.nodes import programs as p; "
    code += "cli.main(['monitor', '/x']); cli.main(['live']); p.identifier()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    words = r"(fden monitor|fden live|identifier): this needs ROS 2 \(.*rclpy.*\[wheels\].*"
    lines = done.stderr.splitlines()
    assert len(lines) == 3 and all(re.fullmatch(words, line) for line in lines), done.stderr


@pytest.mark.wheels
def test_wheels_work_in_a_new_environment_without_ros_and_with_it(tmp_path):
    own, messages = (
        next((ROOT / "dist").glob(f"{name}-*.whl")) for name in ("fden_ros", "fden_msgs")
    )
    foreign = ("PYTHON", "ROS", "_ROS", "AMENT", "CMAKE", "LD_", "VIRTUAL", "RMW", "COLCON")
    clean = {key: value for key, value in os.environ.items() if not key.startswith(foreign)}
    programs = tmp_path / "venv" / "bin"
    options: dict[str, Any] = {
        "cwd": tmp_path,
        "env": {**clean, "PATH": f"{programs}:/usr/bin:/bin"},
    }
    run(sys._base_executable, "-m", "venv", tmp_path / "venv", **options)  # type: ignore[attr-defined]
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    run("pip", "install", own, **options)
    with pytest.raises(AssertionError, match="No module named 'rclpy'"):
        run("python", "-c", "import rclpy", **options)
    example = run("python", "examples/identify_arrays.py", **options).stdout
    assert example == run(sys.executable, "examples/identify_arrays.py", cwd=ROOT).stdout
    run("fden", "report", *PRESS, "-o", "report.html", **options)

    run("pip", "install", f"{own}[wheels]", messages, **options)
    options["env"] |= {name: os.environ[name] for name in ("ROS_DOMAIN_ID",)}
    options["env"]["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    shown = run("fden", "live", "--duration", "20", **options).stdout
    assert "contact 1 at site 1" in shown  # on a busy machine not in time to be relied on


PACKAGE = Path(__file__).parent.parent / "fden_ros"

#: Rooms in the order of the data: each imports only what stands above it here.
ROOMS = [
    "advice", "errors", "one_thread", "progress", "shipped", "written", "core.arrays",
    "core.parameter", "core.streams", "core.law", "core.noise_filter", "core.contact",
    "core.estimation", "core.paper_filter", "core.oscillation", "core.classification",
    "core.plausibility", "core.config", "core.stiffness", "core.outputs", "core.block",
    "core.lift_off", "core.origin", "core.standing", "core.whereabouts", "core.site",
    "core.air_after", "core.report", "core.site_contact", "core.sites", "core.strokes",
    "core.contact_session", "core.continuous_session", "core.input_warnings", "core.pipeline",
    "core", "simulation", "tissues", "message_kinds", "parameters", "inputs", "recording", "ros",
    "experiments", "control", "tissue_feed", "offline", "configure", "report", "arrays", "nodes",
    "commands", "cli",
]  # fmt: skip


def room_of(module: str) -> str:
    """The room of a module's name; empty for the package itself."""
    parts = module.split(".")[1:]
    return ".".join(parts[: 2 if parts[:1] == ["core"] else 1])


def modules_of(path: Path) -> Iterator[str]:
    """The modules of the package that a module imports, anywhere in it."""
    for module, name in imports_of(path):
        below = PACKAGE.parent.joinpath(*module.split("."), name)
        is_module = name and (below.with_suffix(".py").is_file() or below.is_dir())
        yield f"{module}.{name}" if is_module else module


def arrows() -> set[tuple[str, str, str]]:
    """Every import from one room into another, with the file that has it."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        name = path.relative_to(PACKAGE.parent).with_suffix("")
        module = ".".join(name.parts).removesuffix(".__init__")
        for imported in modules_of(path):
            if imported.split(".")[0] == "fden_ros" and room_of(imported) != room_of(module):
                found.add((str(path.relative_to(PACKAGE)), room_of(module), room_of(imported)))
    return found


def test_imports_run_one_way():
    places = {room: place for place, room in enumerate(ROOMS)} | {"": -1}
    # The package itself names `fit`, which is imported when it is asked for.
    found = {arrow for arrow in arrows() if arrow[1:] != ("", "arrays")}
    assert {room for _, *both in found for room in both} <= set(places)
    upward = {arrow for arrow in found if places[arrow[2]] >= places[arrow[1]]}
    assert upward == set()


POLICY = ROOT / "config" / "sros2_policy.xml"
NAMESPACE, NODE = "/", "identifier"


def allowed(kind: str, right: str, node: str = NODE) -> set[str]:
    """Full names that the policy allows a node, such as ``topic`` and ``publish``."""
    path = f"./enclaves/enclave[@path='/{node}']/profiles/profile"
    (profile,) = ElementTree.parse(POLICY).iterfind(path)
    assert (profile.get("ns"), profile.get("node")) == (NAMESPACE, node)
    names = [
        str(entry.text)
        for group in profile.iterfind(f"{kind}s[@{right}='ALLOW']")
        for entry in group.iterfind(kind)
    ]
    assert len(set(names)) == len(names)
    return {name.replace("~", f"/{node}") if name[0] in "~/" else f"/{name}" for name in names}


def test_the_policy_names_what_the_running_node_has_and_nothing_else():
    parameters = {
        "autostart": True,
        "use_sim_time": True,
        "frames.base": "base",
        "start_type_description_service": True,
    }
    expected = [
        allowed("topic", "subscribe"),
        allowed("topic", "publish"),
        allowed("service", "reply"),
        allowed("service", "request"),
    ]
    with identifier(parameters):
        for _ in range(3):
            # Discovery at times passes a participant by; the next one hears of everything anew.
            with Bench() as bench:
                bench.wait_until_heard()
                with contextlib.suppress(AssertionError):
                    bench.wait_for(lambda: _names(bench.node) == expected, "the names", 30.0)
                    return
                found = _names(bench.node)
    assert found == expected


def _names(node: Any) -> list[set[str]]:
    """Return the identifier's names: topics heard and published, services, clients.

    There are none while discovery has not brought its name.
    """
    asks = (
        node.get_subscriber_names_and_types_by_node,
        node.get_publisher_names_and_types_by_node,
        node.get_service_names_and_types_by_node,
        node.get_client_names_and_types_by_node,
    )
    try:
        return [{name for name, _ in ask(NODE, NAMESPACE)} for ask in asks]
    except NodeNameNonExistentError:
        return []


@pytest.mark.parametrize("read", [read_parameter_file, load_library])
def test_a_tag_in_a_file_is_refused_and_not_run(read, tmp_path):
    made = tmp_path / "made"
    file = tmp_path / "tag.yaml"
    file.write_text(f"!!python/object/apply:pathlib.Path.touch [!!python/name:x {made}]\n")
    with pytest.raises(InputError) as refused:
        read(file)
    assert "\n" not in str(refused.value)
    assert not made.exists()
