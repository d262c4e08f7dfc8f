# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The options of every command, as one table."""

from __future__ import annotations

import argparse
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from fden_ros.commands.command import count, number, positive
from fden_ros.errors import InputError
from fden_ros.experiments.kinds import EXPERIMENTS
from fden_ros.parameters import PARAMETERS
from fden_ros.shipped import robot_names

_Value = TypeVar("_Value")
#: Inputs whose topic or field may be named: those that have a type of message.
STREAMS = [p.name.partition(".")[0] for p in PARAMETERS if p.name.endswith(".message")]


@dataclass(frozen=True)
class Option:
    """An argument of a command: its names, its help, and what argparse takes."""

    names: tuple[str, ...]
    more: Mapping[str, Any]


@dataclass(frozen=True)
class Group:
    """Options under a title; without a title they exclude each other."""

    title: str
    options: Sequence[Option | Group]


def _option(names: str, words: str, kind: Any = None, metavar: str = "", **more: Any) -> Option:
    if kind is bool:
        more["action"] = "store_true"
    elif kind is not None:
        more["type"] = kind
    if metavar:
        more["metavar"] = metavar
    return Option(tuple(names.split()), {**more, "help": words})


def add_options(parser: Any, options: Sequence[Option | Group]) -> None:
    """Add options to a parser."""
    for one in options:
        if isinstance(one, Option):
            parser.add_argument(*one.names, **one.more)
        elif one.title:
            add_options(parser.add_argument_group(one.title), one.options)
        else:
            add_options(parser.add_mutually_exclusive_group(), one.options)


def _argument(parse: Callable[[str], _Value]) -> Callable[[str], _Value]:
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
    from fden_ros.recording.headings import factor_of

    match = re.fullmatch(r"\s*([\d.]+(?:[eE][-+]?\d+)?)\s*([^\d\s].*)?", text)
    factor = factor_of(quantity, match[2] or ("m2" if quantity == "area" else "m")) if match else 0
    try:
        size = float(match[1]) * (factor or 0.0) if match else 0.0
    except ValueError:
        size = 0.0
    if size > 0.0:
        return size
    examples = "1963mm2, or 1.963e-3 in m^2" if quantity == "area" else "50mm, or 0.05 in m"
    raise InputError(
        f"{text!r} is not a size: expected a number with its unit, such as {examples}"
    )


def _area(text: str) -> float:
    return _size(text, "area")


def _pair(separator: str, expected: str) -> Callable[[str], tuple[str, str]]:
    def parse(text: str) -> tuple[str, str]:
        name, found, value = text.partition(separator)
        if not (name and found and value):
            raise argparse.ArgumentTypeError(f"{text!r} is not {expected}")
        return name.strip(), value.strip()

    return parse


JSON = _option("--json", "print one JSON object", bool)
_IDENTIFIER = _option(
    "identifier", "name of the node (default: %(default)s)", nargs="?", default="/identifier"
)
_DURATION = _option("--duration", "stop after this time [s]", positive, "S")
_BAG = _option("bag", "a bag or a table: a path, or a URL of s3, https, sftp", metavar="BAG")
_REPLACE = _option("--force", "replace what is there already", bool)
CONFIG = (
    _option(
        "--config",
        "parameter file (YAML); give several, and later ones override",
        Path,
        "FILE",
        action="append",
    ),
    _option(
        "--node",
        "node whose sections are read (default: %(default)s)",
        str,
        "NAME",
        default="/identifier",
    ),
)
#: Where in a recording force and displacement are.
SELECTION = Group(
    "force and displacement (found automatically if possible)",
    (
        *(_option(f"--{one}-topic", f"topic of the {one}", metavar="T") for one in STREAMS),
        *(
            _option(
                f"--{one}-field",
                f"message field that holds the {one}, such as wrench.torque.z or data[2]; a "
                f"vector is projected onto {one}.axis",
                _argument(_field_path),
                "PATH",
            )
            for one in STREAMS
        ),
        _option(
            "--stamps",
            "take the times of a bag from its message headers or from its recording",
            choices=("header", "recording"),
        ),
        _option(
            "--columns",
            "columns of a table with time, force and displacement, by heading or number, each "
            "with an optional factor to s, N and m: time_s,force_N,depth_mm*1e-3. Write @500 "
            "for the time of rows at 500 Hz. Not needed if the headings name them with units",
            _argument(_columns),
            "T,F,D",
        ),
        _option(
            "--rows",
            "use only the rows with this text in this column",
            _pair("=", "COLUMN=TEXT"),
            "COLUMN=TEXT",
        ),
    ),
)
_FACE = (
    _option("--diameter", "diameter of specimen or face: 50mm, or in m", _argument(_size), "D"),
    _option("--area", "area of specimen or face: 1963mm2, or in m^2", _argument(_area), "A"),
)
_MACHINE = Group(
    "a testing machine's table",
    (
        _option(
            "--from-touch",
            "the table begins at the touch or at a preload, tared, without air; the rig is rigid "
            "(config/bench.yaml)",
            action=argparse.BooleanOptionalAction,
        ),
        Group("", _FACE),
        _option(
            "--height --thickness", "height of the specimen: 30mm, or in m", _argument(_size), "H"
        ),
    ),
)
_INPUT = (*CONFIG, SELECTION, _MACHINE)
_WORKERS = (
    _option(
        "--workers",
        "number of processes (default: one per core)",
        count,
        "N",
        default=len(os.sched_getaffinity(0)),
    ),
    _option(
        "--scheduler", "scheduler of a Dask cluster: tcp://HOST:8786, or its file", str, "ADDRESS"
    ),
)
_FIT = (
    _option("--stress", "for creep: the constant stress", positive, "PA"),
    _option("--strain", "for relaxation: the constant strain, a ratio", positive, "X"),
    _option(
        "--from",
        "leave out rows before this time (default for creep: 1 s)",
        number(),
        "S",
        dest="start",
    ),
    _option("--alpha", "fractional order, if it is known", number(above=0.0, below=1.0), "A"),
    _option("--alpha-sd", "standard deviation of A (default: exact)", positive, "SD"),
)
_INDENTER = (
    _option("--flat-punch", "area of a flat face [m^2]", float, "AREA"),
    _option("--thickness", "thickness of the tissue [m]", float, "H"),
    _option("--sphere", "radius of a spherical tip [m]", float, "R"),
)


def _output(words: str, metavar: str = "FILE", **more: Any) -> Option:
    return _option("-o --output", words, Path, metavar, **more)


OPTIONS: Mapping[str, Sequence[Option | Group]] = {
    "bag": (
        _option("scenario", "name of a scenario, or a YAML file", str, "SCENARIO", nargs="?"),
        _output("folder of the new bag", "DIR"),
        _option("--seed", "seed of tissue and noise", number(least=0, whole=True), "N"),
        _REPLACE,
        _option("--list", "list the scenarios and exit", bool),
    ),
    "replay": (
        _BAG,
        *_INPUT,
        _output("also write what the node would publish, as a bag", "OUT"),
        _REPLACE,
        JSON,
    ),
    "report": (_BAG, _output("file of the page, HTML"), *_INPUT),
    "batch": (
        _option(
            "places", "bags, tables, folders of them, or patterns", str, "DIR_OR_GLOB", nargs="+"
        ),
        _output("file of the table, CSV or .parquet", required=True),
        Group("", _WORKERS),
        *_INPUT,
    ),
    "play": (
        _option("bag", "a bag", str, "BAG"),
        _option("--rate", "speed of playing (default: 1)", positive, "R", default=1.0),
        _option(
            "--remap",
            "publish a topic by another name",
            _pair(":=", "FROM:=TO"),
            "FROM:=TO",
            nargs="+",
            default=[],
        ),
    ),
    "train": (
        _option(
            "labelled",
            "a tissue, and the table of fden batch with its contacts",
            str,
            "TISSUE=TABLE",
            nargs="+",
        ),
        _output("file of the library, YAML", required=True),
        *CONFIG,
    ),
    "fit": (
        _option("kind", ", ".join(EXPERIMENTS), metavar="KIND", choices=EXPERIMENTS),
        _option("file", "a CSV file, or a folder of CSV files", Path, "FILE"),
        JSON,
        Group("if the file does not say it", _FIT),
    ),
    "configure": (
        _option("recordings", "bags or tables, all of one rig", Path, "RECORDING", nargs="+"),
        _output("parameter file to write"),
        _option(
            "--robot",
            f"a known robot: {', '.join(robot_names())}",
            str,
            "NAME",
            choices=robot_names(),
        ),
        JSON,
        _option(
            "--rigid",
            "a recording of rigid presses",
            Path,
            "RECORDING",
            action="append",
            default=[],
        ),
        Group("the indenter, which no recording shows", _INDENTER),
        SELECTION,
    ),
    "parameters": (),
    "monitor": (_IDENTIFIER, _DURATION),
    "live": (
        _option(
            "--parameters", "parameter file (default: config/tissue_simulator.yaml)", Path, "FILE"
        ),
        _option("--fixed", "control with fixed gains", bool),
        _DURATION,
    ),
}
