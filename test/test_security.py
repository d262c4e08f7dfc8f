# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Least privilege, and nothing read is ever executed."""

from __future__ import annotations

import contextlib
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


def test_the_policy_names_what_the_running_node_has_and_nothing_else():
    parameters = {
        "autostart": True,
        "use_sim_time": True,
        "surface.message": "pose",
        "frames.base": "base",
        "start_type_description_service": True,
    }
    expected = [
        allowed("topic", "subscribe"),
        allowed("topic", "publish"),
        allowed("service", "reply"),
        allowed("service", "request"),
    ]
    # The identifier first: it ends the shared one, whose names a node from before may keep.
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
    """Return the identifier's names: topics heard and published, services, clients."""
    return [
        {name for name, _ in ask(NODE, NAMESPACE)}
        for ask in (
            node.get_subscriber_names_and_types_by_node,
            node.get_publisher_names_and_types_by_node,
            node.get_service_names_and_types_by_node,
            node.get_client_names_and_types_by_node,
        )
    ]


@pytest.mark.parametrize("read", [read_parameter_file, load_library])
def test_a_tag_in_a_file_is_refused_and_not_run(read, tmp_path):
    made = tmp_path / "made"
    file = tmp_path / "tag.yaml"
    file.write_text(f"!!python/object/apply:pathlib.Path.touch [!!python/name:x {made}]\n")
    with pytest.raises(InputError) as refused:
        read(file)
    assert "\n" not in str(refused.value)
    assert not made.exists()
