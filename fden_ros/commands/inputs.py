# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Options of several commands: the parameters, and the sources within a recording."""

from __future__ import annotations

import argparse
import shlex
import sys
from typing import TYPE_CHECKING, Any

from fden_ros.commands.options import SELECTION, STREAMS, add_options

if TYPE_CHECKING:
    from fden_ros.parameters import Parameters


def parameters_of(args: argparse.Namespace) -> Parameters:
    """Return the checked parameters of every ``--config`` for ``--node``, and of sizes given."""
    from fden_ros.parameters import open_axes, read_parameter_files
    from fden_ros.shipped import shipped

    files = list(args.config or [])
    if getattr(args, "from_touch", None):
        # The files override it.
        files.insert(0, shipped("config/bench.yaml"))
    parameters = read_parameter_files(files, args.node)
    for path in files:
        for words in open_axes(path):
            print(f"ATTENTION: {path}: {words}", file=sys.stderr)
    sizes = _sizes_of(args)
    if sizes and parameters.geometry.kind != "flat_punch":
        args.parser.error(
            "--diameter, --area and --height are for geometry.kind flat_punch, not for "
            f"{parameters.geometry.kind}"
        )
    return parameters.changed(sizes) if sizes else parameters


def _sizes_of(args: argparse.Namespace) -> dict[str, float]:
    """Return the sizes of a specimen that the options state."""
    from fden_ros.recording.machine import area_of

    diameter, area = getattr(args, "diameter", None), getattr(args, "area", None)
    sizes = {
        "geometry.area": area if diameter is None else area_of(diameter),
        "geometry.thickness": getattr(args, "height", None),
    }
    return {name: size for name, size in sizes.items() if size is not None}


def selection_of(args: argparse.Namespace) -> Any:
    """Return the :class:`~fden_ros.recording.source.Selection` that the options make."""
    from fden_ros.recording.source import Selection

    if args.stamps is not None and args.columns is not None:
        args.parser.error("--stamps is for bags: in a table the first of --columns is the time")
    _take_from_files(args)
    topics, fields = (
        {name: value for name in STREAMS if (value := getattr(args, f"{name}_{part}"))}
        for part in ("topic", "field")
    )
    from_touch = getattr(args, "from_touch", None)
    stamps = args.stamps or "header"
    return Selection(topics, fields, args.columns, args.rows, stamps, from_touch)


def _take_from_files(args: argparse.Namespace) -> None:
    """Fill in what ``fden configure`` has written of a recording, where no option says it."""
    from fden_ros.recording.source import SELECTION_LINE
    from fden_ros.recording.text import looks_like_a_table

    paths = [path for path in map(vars(args).get, ("bag", "recording")) if path is not None]
    paths += getattr(args, "places", [])
    is_table = args.columns is not None or (bool(paths) and all(map(looks_like_a_table, paths)))
    for path in getattr(args, "config", None) or []:
        if not path.is_file():
            continue
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            if not line.startswith(SELECTION_LINE):
                continue
            parser = argparse.ArgumentParser()
            add_options(parser, [SELECTION])
            written = parser.parse_known_args(shlex.split(line.removeprefix(SELECTION_LINE)))[0]
            for name, value in vars(written).items():
                if getattr(args, name) is None and is_table == (name in ("columns", "rows")):
                    setattr(args, name, value)
