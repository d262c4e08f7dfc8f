# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Least privilege, and nothing read is ever executed."""

from __future__ import annotations

import ast
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import pytest
from ros_helpers import Bench, identifier

from fden_ros.errors import InputError
from fden_ros.parameters import read_parameter_file
from fden_ros.tissues.library import load_library

ROOT = Path(__file__).parent.parent
POLICY = ROOT / "config" / "sros2_policy.xml"
NAMESPACE, NODE = "/", "identifier"


def allowed(kind: str, right: str) -> set[str]:
    """Full names that the policy allows, such as ``topic`` and ``publish``."""
    (profile,) = ElementTree.parse(POLICY).iterfind("./enclaves/enclave/profiles/profile")
    assert (profile.get("ns"), profile.get("node")) == (NAMESPACE, NODE)
    names = [
        str(entry.text)
        for group in profile.iterfind(f"{kind}s[@{right}='ALLOW']")
        for entry in group.iterfind(kind)
    ]
    assert len(set(names)) == len(names)
    return {name.replace("~", f"/{NODE}") if name[0] in "~/" else f"/{name}" for name in names}


def test_the_policy_names_what_the_running_node_has_and_nothing_else() -> None:
    parameters = {
        "autostart": True,
        "use_sim_time": True,
        "surface.message": "pose",
        "frames.base": "base",
        "start_type_description_service": True,
    }
    with Bench() as bench, identifier(parameters):
        bench.wait_until_heard()
        node = bench.node

        def names(ask: Any) -> set[str]:
            return {name for name, _ in ask(NODE, NAMESPACE)}

        def found() -> list[set[str]]:
            return [
                names(node.get_subscriber_names_and_types_by_node),
                names(node.get_publisher_names_and_types_by_node),
                names(node.get_service_names_and_types_by_node),
                names(node.get_client_names_and_types_by_node),
            ]

        expected = [
            allowed("topic", "subscribe"),
            allowed("topic", "publish"),
            allowed("service", "reply"),
            allowed("service", "request"),
        ]
        bench.wait_for(
            lambda: found() == expected,
            f"what the policy says; more or less: "
            f"{[a ^ b for a, b in zip(found(), expected, strict=True)]}",
        )


def test_nothing_that_could_execute_a_file_is_used() -> None:
    """No pickle, no eval, no shell, and PyYAML by its safe loader only."""
    modules = {"pickle", "marshal", "shelve", "dill", "joblib"}
    calls = {"eval", "exec", "__import__"}
    unsafe = {"load", "load_all", "unsafe_load", "full_load", "Loader", "UnsafeLoader"}
    for path in sorted((ROOT / "fden_ros").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            where = f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 0)}"
            if isinstance(node, ast.Import):
                assert not modules & {alias.name.split(".")[0] for alias in node.names}, where
            if isinstance(node, ast.ImportFrom):
                assert (node.module or "").split(".")[0] not in modules, where
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                assert node.func.id not in calls, where
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                assert not (node.value.id == "yaml" and node.attr in unsafe), where
            if isinstance(node, ast.keyword) and node.arg == "allow_pickle":
                assert isinstance(node.value, ast.Constant) and node.value.value is False, where
            if isinstance(node, ast.keyword) and node.arg == "shell":
                assert isinstance(node.value, ast.Constant) and node.value.value is False, where


@pytest.mark.parametrize("read", [read_parameter_file, load_library])
def test_a_tag_in_a_file_is_refused_and_not_run(read: Any, tmp_path: Path) -> None:
    made = tmp_path / "made"
    file = tmp_path / "tag.yaml"
    file.write_text(f"!!python/object/apply:pathlib.Path.touch [!!python/name:x {made}]\n")
    with pytest.raises(InputError) as refused:
        read(file)
    assert "\n" not in str(refused.value)
    assert not made.exists()
