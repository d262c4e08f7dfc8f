# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Options that several commands share: what of a recording is force, what is displacement."""

from __future__ import annotations

import argparse
import re
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from fden_ros.errors import InputError
from fden_ros.parameters import PARAMETERS

if TYPE_CHECKING:
    from fden_ros.parameters import Parameters

_Value = TypeVar("_Value")
#: Inputs whose topic or field may be named: those that have a type of message.
_STREAMS = [p.name.partition(".")[0] for p in PARAMETERS if p.name.endswith(".message")]


def add_recording(parser: argparse.ArgumentParser) -> None:
    """Add the recording itself, ``bag``."""
    parser.add_argument(
        "bag",
        metavar="BAG",
        help="a bag (folder, .mcap, .db3, .bag) or a table: a path, or a URL of s3, https, sftp",
    )


def add_input_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--config`` and the options that say where each quantity is."""
    add_config_options(parser)
    add_selection_options(parser)
    add_machine_options(parser)


def add_selection_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say where in a recording force and displacement are."""
    group = parser.add_argument_group(
        "what is force, what is displacement (found where it can be)"
    )
    for stream in _STREAMS:
        group.add_argument(f"--{stream}-topic", metavar="T", help=f"topic of the {stream}")
    for stream in _STREAMS:
        group.add_argument(
            f"--{stream}-field",
            type=as_argument(_field_path),
            metavar="PATH",
            help=f"field of that topic's messages, of any type, that is the {stream}: a number, "
            f"or a vector, projected on {stream}.axis (wrench.torque.z, data[2])",
        )
    group.add_argument(
        "--stamps",
        choices=("header", "recording"),
        help="time of a bag's messages: of their headers, or of their recording, where stamps are "
        "0 or of several clocks (default: header)",
    )
    group.add_argument(
        "--columns",
        type=as_argument(_columns),
        metavar="T,F,D",
        help="headings or numbers of a table's columns (CSV): time, force, displacement, "
        "each with an optional factor to s, N and m, as time_s,force_N,depth_mm*1e-3. "
        "@500 as time: rows at 500 Hz. Not needed where headings name them with their units",
    )
    group.add_argument(
        "--rows",
        type=as_argument(_where),
        metavar="COLUMN=TEXT",
        help="use only the rows of the table with this text in this column",
    )


def add_machine_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say what a testing machine has recorded."""
    group = parser.add_argument_group("a testing machine's table")
    group.add_argument(
        "--from-touch",
        action=argparse.BooleanOptionalAction,
        help="it begins at the touch or at a preload, tared, without air. The first sample is the "
        "contact point, the force's bias is 0, and the rig is rigid (config/bench.yaml). All but "
        "the rig is the default where the preamble states a specimen",
    )
    size = as_argument(_size)
    face = group.add_mutually_exclusive_group()
    face.add_argument(
        "--diameter",
        type=size,
        metavar="D",
        help="of the specimen, or of the face that presses into it: 50mm, or in m",
    )
    face.add_argument("--area", type=as_argument(_area), metavar="A", help="1963mm2, or in m^2")
    group.add_argument(
        "--height",
        "--thickness",
        type=size,
        metavar="H",
        help="of the specimen: 30mm, or in m; sizes that stand before the table's headings are "
        "taken where none is given",
    )


def add_config_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--config`` and the node whose sections of the file count."""
    parser.add_argument(
        "--config",
        type=Path,
        action="append",
        metavar="FILE",
        help="parameter file of the identifier (YAML); given again, such as for a prior, the "
        "later file outdoes the earlier",
    )
    parser.add_argument(
        "--node",
        default="/identifier",
        metavar="NAME",
        help="node whose sections of the parameter file count, with its namespace, such as "
        "/arm/identifier (default: %(default)s)",
    )


def parameters_of(args: argparse.Namespace) -> Parameters:
    """Return the checked parameters of every ``--config`` for ``--node``, and of sizes given."""
    from fden_ros.parameters import open_axes, read_parameter_files
    from fden_ros.shipped import shipped

    files = list(args.config or [])
    if getattr(args, "from_touch", None):
        # What the files say outdoes it.
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
        args.parser.error("--stamps is for bags: the first of --columns is a table's time")
    _take_from_files(args)
    topics, fields = (
        {name: value for name in _STREAMS if (value := getattr(args, f"{name}_{part}"))}
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
            add_selection_options(parser)
            written = parser.parse_known_args(shlex.split(line.removeprefix(SELECTION_LINE)))[0]
            for name, value in vars(written).items():
                if getattr(args, name) is None and is_table == (name in ("columns", "rows")):
                    setattr(args, name, value)


def as_argument(parse: Callable[[str], _Value]) -> Callable[[str], _Value]:
    """Return `parse` for argparse: what it refuses is wrong usage."""

    def convert(text: str) -> _Value:
        try:
            return parse(text)
        except InputError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return convert


def _field_path(text: str) -> str:
    from fden_ros.recording.fields import FieldPath

    return FieldPath(text).text


def _columns(text: str) -> Any:
    from fden_ros.recording.table import Columns

    return Columns.parse(text)


def _size(text: str, quantity: str = "displacement") -> float:
    """Return a size in SI units, from a number with or without its unit."""
    from fden_ros.recording.units import factor_of

    match = re.fullmatch(r"\s*([\d.]+(?:[eE][-+]?\d+)?)\s*([^\d\s].*)?", text)
    factor = factor_of(quantity, match[2] or ("m2" if quantity == "area" else "m")) if match else 0
    try:
        size = float(match[1]) * (factor or 0.0) if match else 0.0
    except ValueError:
        size = 0.0
    if size > 0.0:
        return size
    examples = "1963mm2, or 1.963e-3 in m^2" if quantity == "area" else "50mm, or 0.05 in m"
    raise InputError(f"{text!r} is no size: expected a number with its unit, such as {examples}")


def _area(text: str) -> float:
    return _size(text, "area")


def _where(text: str) -> tuple[str, str]:
    name, separator, value = text.partition("=")
    if not name or not separator:
        raise InputError(f"{text!r} is not COLUMN=TEXT")
    return name.strip(), value.strip()
