# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden plan``: which press to make next, and what to expect of it."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fden_ros.commands.command import add_json, positive, print_json, write_picture
from fden_ros.commands.inputs import add_config_options, as_argument, parameters_of
from fden_ros.errors import InputError

if TYPE_CHECKING:
    from fden_ros.planning.tissue import TissueBelief

_NOT_POSSIBLE = 3
_TARGETS = ("G", "Gn", "alpha")
DESCRIPTION = """\
Plan the next press: how deep, how fast, how long. The plan has the standard deviations that the
identifier will state after it, and the probability that these meet the target. Otherwise it says
why no press meets it.
"""

EPILOG = """\
examples:
  fden plan --config probe.yaml --target G=0.1,Gn=0.1
  fden plan --config probe.yaml --config liver.yaml --target Gn=0.05 --max-force 2 --plot plan.png
  fden plan --map palpation.json --region 0,0,0.06,0.06 --plot map.png
  fden replay press.csv --config probe.yaml --json > press.json
      then: fden plan --config probe.yaml --after press.json

Targets are standard deviations of ln G and ln Gn (0.1: to 10 %) and of alpha; without any, what a
contact takes to converge. Noise and rate come from the file of `fden configure`, or are stated.
What is planned holds for tissue of the prior, or of the results of --after; it is never exact.
"""

#: What its exit codes say beside those of all commands.
EXIT_CODES = {3: "the target is not possible"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    add_config_options(parser)
    parser.add_argument(
        "--target",
        type=as_argument(_target),
        metavar="G=SD,...",
        help="standard deviations of ln G, ln Gn and alpha that are wanted",
    )
    limits = parser.add_argument_group("what a press may do")
    for name, unit, usual in (
        ("depth", "m", "a strain of 0.3"),
        ("force", "N", "plausibility.max_force"),
        ("speed", "m/s", "0.02, 0.008 with much noise"),
        ("time", "s", "10"),
    ):
        words = f"at most (default: {usual})"
        limits.add_argument(f"--max-{name}", type=positive, metavar=unit, help=words)
    sensors = parser.add_argument_group("sensors (default: as fden configure has measured them)")
    for name, unit, words in (
        ("noise", "N", "of the force, per sample"),
        ("rate", "Hz", "of the force"),
        ("displacement-noise", "m", "of the displacement, per sample"),
    ):
        sensors.add_argument(f"--{name}", type=positive, default=0.0, metavar=unit, help=words)
    for name, words in (
        ("after", "go on from the last contact of what fden replay --json has printed"),
        ("map", "where to press next, from the places of what fden replay --json has printed"),
    ):
        parser.add_argument(f"--{name}", type=Path, metavar="RESULTS", help=words)
    parser.add_argument(
        "--region",
        type=as_argument(_region),
        metavar="X0,Y0,X1,Y1",
        help="corners of the region of --map [m] (default: around its places)",
    )
    words = "draw deviations against depth and time, or the map"
    parser.add_argument("--plot", type=Path, metavar="FILE", help=words)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Plan and print; return the exit code."""
    return _motion(args) if args.map is None else _place(args)


def _motion(args: argparse.Namespace) -> int:
    """Say how to press next."""
    from fden_ros.offline.sensors import sensors_of
    from fden_ros.parameters import pipeline_config
    from fden_ros.planning.plan import LIMITS, Limits, Search, Target

    parameters = parameters_of(args)
    config = pipeline_config(parameters)
    if not config.geometry.is_stated:
        raise InputError("state probe and tissue (geometry): without it no press can be planned")
    tissue = _tissue(args.after) if args.after else None
    sensors = sensors_of(
        args.config or [], parameters, args.noise, args.rate, args.displacement_noise
    )
    most = {name: getattr(args, f"max_{name}") for name in LIMITS}
    limits = Limits.usual(config, sensors).stated(**most)
    target = Target(args.target) if args.target else None
    search = Search(config, sensors, target, limits, tissue)
    plan = search.plan()
    if args.plot is not None:
        from fden_ros.report.plan_picture import draw_plan

        write_picture(args.plot, lambda figure: draw_plan(figure, search, plan))
    _print(args, plan.line(), plan.numbers())
    return 0 if plan.is_worth_it else _NOT_POSSIBLE


def _place(args: argparse.Namespace) -> int:
    """Say where to press next in a region."""
    from fden_ros.planning.region import Presses, Region

    presses = Presses.of(_rows(args.map))
    if not presses.is_told.any():
        raise InputError(f"{args.map} has no contact with a place and a stiffness in N/m")
    region = Region(*args.region) if args.region else Region.around(presses)
    found = region.propose(presses)
    if args.plot is not None:
        from fden_ros.report.region_picture import draw_region

        write_picture(args.plot, lambda figure: draw_region(figure, region, presses, found))
    _print(args, found.line(), found.numbers())
    return 0


def _print(args: argparse.Namespace, line: str, numbers: Mapping[str, Any]) -> None:
    if args.json:
        print_json({**numbers, "line": line})
    else:
        print(line)


def _target(text: str) -> tuple[float, ...]:
    found = dict.fromkeys(_TARGETS, math.inf)
    for part in text.split(","):
        name, _, value = part.partition("=")
        if name not in _TARGETS:
            raise InputError(f"{part!r}: a target is one of {', '.join(_TARGETS)}")
        try:
            found[name] = positive(value)
        except argparse.ArgumentTypeError as error:
            raise InputError(f"{part!r}: {error}") from None
    return tuple(found.values())


def _region(text: str) -> tuple[tuple[float, float], tuple[float, float]]:
    try:
        x0, y0, x1, y1 = map(float, text.split(","))
    except ValueError:
        raise InputError(f"{text!r} is not four numbers X0,Y0,X1,Y1 [m]") from None
    if not (x0 < x1 and y0 < y1):
        raise InputError(f"{text!r} has no area: X0 < X1 and Y0 < Y1")
    return (x0, y0), (x1, y1)


def _contacts(path: Path) -> list[dict[str, Any]]:
    try:
        found: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))["contacts"]
        return found
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path} cannot be read as the output of fden replay --json: {error}"
        ) from None


def _rows(path: Path) -> Iterator[tuple[float, float, float, float]]:
    """Yield x, y, N/m and its deviation of each contact of results; 0 where none is told."""
    from fden_ros.core.outputs import WITHHELD, Flag

    for one in _contacts(path):
        if not one.get("position"):
            continue
        is_withheld = any(Flag[name.upper()] & WITHHELD for name in one.get("flags", ()))
        told = one.get("apparent_stiffness"), one.get("apparent_stiffness_sd")
        value, sd = (0.0, 0.0) if is_withheld else (number or 0.0 for number in told)
        yield (*one["position"][:2], value, sd)


def _tissue(path: Path) -> TissueBelief:
    """Return what the results of a replay tell of the tissue at their last place."""
    from fden_ros.planning.tissue import TissueBelief

    known = [one["components"] for one in _contacts(path) if one.get("components")]
    if not known:
        raise InputError(f"{path} has no contact with an estimate")
    return TissueBelief.of(known[-1])
