# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The layout: imports run one way, from what is nearer the user to what is nearer the data."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "fden_ros"

#: Rooms in the order of the data: each imports only what stands above it here.
ROOMS = (
    "errors",
    "one_thread",
    "progress",
    "shipped",
    "core.arrays",
    "core.streams",
    "core.law",
    "core.contact",
    "core.estimation",
    "core.oscillation",
    "core.classification",
    "core.plausibility",
    "core.config",
    "core.outputs",
    "core.block",
    "core.lift_off",
    "core.site",
    "core.press",
    "core.air_check",
    "core.contact_session",
    "core.continuous_session",
    "core.input_warnings",
    "core.pipeline",
    "core",  # its public names
    "planning",
    "simulation",
    "experiments",
    "tissues",
    "parameters",
    "ros",
    "recording",
    "control",
    "tissue_feed",
    "offline",
    "configure",
    "report",
    "nodes",
    "commands",
    "cli",
)
#: Modules that stand alone at the root.
LOOSE = {"errors", "one_thread", "progress", "shipped", "tissue_feed", "cli"}


def room_of(module: str) -> str:
    """The room of a module's name; empty for the package itself."""
    parts = module.split(".")[1:]
    return ".".join(parts[: 2 if parts[:1] == ["core"] else 1])


def imports_of(path: Path) -> Iterator[str]:
    """The modules of the package that a module imports, anywhere in it."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            module = node.module or ""
            for alias in node.names:
                below = PACKAGE.parent.joinpath(*module.split("."), alias.name)
                is_module = below.with_suffix(".py").is_file() or below.is_dir()
                yield f"{module}.{alias.name}" if is_module else module


def arrows() -> set[tuple[str, str, str]]:
    """Every import from one room into another, with the file that has it."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        name = path.relative_to(PACKAGE.parent).with_suffix("")
        module = ".".join(name.parts).removesuffix(".__init__")
        for imported in imports_of(path):
            if imported.split(".")[0] == "fden_ros" and room_of(imported) != room_of(module):
                found.add((str(path.relative_to(PACKAGE)), room_of(module), room_of(imported)))
    return found


def test_every_room_has_its_place():
    found = {room for _, user, used in arrows() for room in (user, used)} - {""}
    assert found <= set(ROOMS)
    loose = {path.stem for path in PACKAGE.glob("*.py")} - {"__init__"}
    assert loose == LOOSE


def test_imports_run_one_way():
    places = {room: place for place, room in enumerate(ROOMS)} | {"": -1}
    upward = {arrow for arrow in arrows() if places[arrow[2]] >= places[arrow[1]]}
    assert upward == set()
