# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Parameter files, read as ROS 2 reads them: sections by node name, wildcards, plain YAML.

The node and ``fden replay`` refuse the same files with the same words, because the node lets this
module look at its files first.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from fden_ros.errors import InputError
from fden_ros.parameters.table import Parameters, identifier_values

#: Line of a parameter file that names a live node's topics, as remappings.
LIVE_LINE = "# Live: "
#: Begins a line in which a parameter file warns about its own numbers; its continuation lines
#: begin with one blank more.
ATTENTION_LINE = "# ATTENTION: "
#: Begins such a warning about a direction that the recording does not show.
OPEN_AXIS = "the axis of the "
#: The node whose sections count where no other is named.
NODE = "/identifier"
_KEY = "ros__parameters"


def live_topics(path: str | Path) -> dict[str, str]:
    """Return the topics that `fden configure` has written for ``force`` and ``displacement``."""
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
        own = [line.removeprefix(LIVE_LINE) for line in lines if line.startswith(LIVE_LINE)]
        words = shlex.split(" ".join(own))
    except (OSError, ValueError):
        # The reader of its parameters reports what is wrong with it.
        return {}
    return dict(word.split(":=", 1) for word in words if ":=" in word)


@dataclass(frozen=True)
class Section:
    """The parameters for the nodes of one name, which may hold wildcards."""

    node: str
    values: Mapping[str, object]  #: by dotted name

    def is_for(self, node: str) -> bool:
        """Return whether the fully qualified name `node` is meant.

        ``*`` stands for one part of a name, ``**`` for any number of them.
        """
        parts = {"*": r"/\w+", "**": r"(/\w+)*"}
        pattern = "".join(
            parts.get(part, "/" + re.escape(part)) for part in _qualified(self.node)[1:].split("/")
        )
        return re.fullmatch(pattern, _qualified(node)) is not None


def open_axes(path: str | Path) -> list[str]:
    """Return what a parameter file says of axes and signs that are not known, a line each."""
    text = Path(path).read_text(encoding="utf-8", errors="replace").replace("\n#   ", " ")
    begin = ATTENTION_LINE + OPEN_AXIS
    lines = [line for line in text.splitlines() if line.startswith(begin)]
    return [line.removeprefix(ATTENTION_LINE) for line in lines]


def read_parameter_file(path: str | Path, node: str = NODE) -> Parameters:
    """Read the parameters of one node from one file: :func:`read_parameter_files`."""
    return read_parameter_files([path], node)


def read_parameter_files(paths: Iterable[str | Path], node: str = NODE) -> Parameters:
    """Read the parameters of one node, such as ``/arm/identifier``, from ROS 2 parameter files.

    Of the sections that are for the node, by name or wildcard, the later outdoes the earlier, and
    the later file the earlier.
    """
    parameters = Parameters()
    for path in paths:
        sections = read_sections(path)
        try:
            parameters = parameters.changed(identifier_values(values_for(sections, node)))
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
    return parameters


def values_for(sections: list[Section], node: str) -> dict[str, object]:
    """Return the values of the sections that are for `node`."""
    chosen = [section.values for section in sections if section.is_for(node)]
    if not chosen:
        named = ", ".join(dict.fromkeys(_qualified(section.node) for section in sections))
        raise InputError(
            f"there is no section for the node {_qualified(node)}, only for {named}: `/**` is for "
            "every node"
        )
    return {name: value for values in chosen for name, value in values.items()}


def read_sections(path: str | Path) -> list[Section]:
    """Return every section of a parameter file, in its order."""
    try:
        return list(_sections(parse_yaml(Path(path).read_text(encoding="utf-8")), ""))
    except OSError as error:
        reason = f"cannot read the parameter file: {error.strerror}"
    except InputError as error:
        reason = str(error)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        reason = f"not valid YAML: {' '.join(str(error).split())}"
    raise InputError(f"{path}: {reason}")


def _sections(tree: object, node: str) -> Iterator[Section]:
    if not isinstance(tree, Mapping) or not tree:
        raise InputError(
            f"no mapping {_KEY}: parameters belong below `/**:`, or the node's name, and "
            f"`{_KEY}:`; `fden parameters` prints a file"
        )
    for key, below in tree.items():
        if key == _KEY and isinstance(below, Mapping):
            yield Section(node, dict(_leaves(below, "")))
        else:
            yield from _sections(below, f"{node}/{str(key).strip('/')}")


def _leaves(tree: Mapping[object, object], prefix: str) -> Iterator[tuple[str, object]]:
    for key, value in tree.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{name}.")
            continue
        if value is None:
            raise InputError(f"parameter {name} has no value")
        check_types(name, value)
        yield name, value


def check_types(name: str, value: object) -> None:
    """Refuse a list that ROS 2 does not read: of values of several types."""
    if isinstance(value, list) and len({type(v) for v in value}) > 1:
        are_numbers = all(type(v) in (int, float) for v in value)
        hint = f": write {[float(v) for v in value]}" if are_numbers else ""
        raise InputError(
            f"parameter {name} is {value}, which ROS 2 cannot read, because it mixes whole "
            f"numbers and others, or other types{hint}"
        )


def parse_yaml(text: str) -> Any:
    """Return the value of a text as a parameter file has it; yaml's errors are let through."""
    return yaml.load(text, _Loader)  # noqa: S506, it is a SafeLoader


def _qualified(node: str) -> str:
    return "/" + node.strip("/")


class _Loader(yaml.SafeLoader):
    """Plain YAML with the numbers of ROS 2's own reader: 1e-4 is one."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> Any:
        """Refuse a name that appears twice, because one value would be lost."""
        names = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        for name in names:
            if names.count(name) > 1:
                raise yaml.YAMLError(f"{name} appears twice in one mapping")
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+$"),
    list("-+.0123456789"),
)
