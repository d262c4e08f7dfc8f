# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden configure``: a parameter file from recordings of a probe that is not configured."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from fden_ros.commands.command import print_json, write
from fden_ros.commands.inputs import selection_of
from fden_ros.errors import InputError

if TYPE_CHECKING:
    from fden_ros.configure.finding import Finding
    from fden_ros.configure.reading import Reading
    from fden_ros.configure.robots import Robot
    from fden_ros.configure.survey import Survey

DESCRIPTION = """\
Find axes and signs, units, rates, noise, bias, drift, the delay between force
and displacement, the compliance and the weight of the tool in a recording.
Each finding has its standard deviation. The command lists what the recording
cannot show, with the motion that would show it, and writes a commented
parameter file.
"""

EPILOG = """\
examples:
  fden configure palpation.mcap -o probe.yaml --flat-punch 3.14e-4 --thickness 0.02
  fden configure plate.mcap tissue.mcap --rigid plate.mcap -o probe.yaml
  fden configure robot.csv --columns @500,5,3*1e-3        500 Hz, force and depth by number
  fden configure press.csv --json | jq '.findings[] | select(.claim == false)'

To record everything, stay in the air for 2 s, and turn the tool through three
orientations. Then press a rigid plate twice, and tissue three times with a
hold of 2 s. Then move in tissue by a sine of 0.5 mm at 1 and 4 Hz. No
recording shows the indenter: state it. With --robot ur a table needs the
headings of the robot's recorder.
"""

#: Exit codes in addition to those of all commands.
EXIT_CODES = {0: "a parameter file was proposed"}


def run(args: argparse.Namespace) -> int:
    """Read, find out, print and write; return the exit code."""
    from fden_ros.configure.robots import robot_named, robot_notes
    from fden_ros.configure.writer import parameter_file, replay_problems

    _check(args)
    robot = robot_named(args.robot) if args.robot else None
    readings, found = _read(args, robot)
    notes = robot_notes(robot, found) if robot is not None else []
    if args.output is not None:
        text = parameter_file(found, readings, notes)
        write(args.output, lambda path: path.write_text(text, encoding="utf-8"))
    if args.json:
        return print_json(result_object(found, readings))
    _show(found, readings, briefly=args.output is not None)
    for note in notes:
        print(f"note: {note}")
    for problem in replay_problems(found):
        print(f"ATTENTION: {problem}")
    if args.output is not None:
        print(f"wrote {args.output}")
    if args.output is None:
        print("Next: the same with -o probe.yaml")
    else:
        recording, config = shlex.quote(str(readings[-1].path)), shlex.quote(str(args.output))
        print(f"Next: fden replay {recording} --config {config}")
    return 0


def result_object(found: Survey, readings: Sequence[Reading]) -> dict[str, Any]:
    """Return what ``--json`` prints."""
    from fden_ros.configure.writer import parameter_values, replay_problems

    names = ("subject", "claim", "value", "deviation", "probability", "unit", "evidence", "motion")
    return {
        "inputs": [
            {
                "recording": str(reading.path),
                **reading.inputs,
                "types": dict(reading.types),
                "joints": dict(reading.joints),
            }
            for reading in readings
        ],
        "findings": [{name: getattr(f, name) for name in names} for f in found.findings],
        "parameters": parameter_values(found, readings),
        "problems": replay_problems(found),
    }


def _check(args: argparse.Namespace) -> None:
    """Refuse arguments that contradict each other."""
    unknown = [str(path) for path in args.rigid if path not in args.recordings]
    for is_wrong, words in (
        (unknown, f"--rigid {' '.join(unknown)} is not one of the recordings"),
        (
            args.sphere is not None and args.flat_punch is not None,
            "--sphere and --flat-punch exclude each other",
        ),
        (
            args.flat_punch is not None and args.thickness is None,
            "--flat-punch AREA needs --thickness H",
        ),
        (
            args.thickness is not None and args.sphere is None and args.flat_punch is None,
            "--thickness H needs --flat-punch AREA or --sphere R",
        ),
    ):
        if is_wrong:
            args.parser.error(words)


def _indenter(args: argparse.Namespace) -> dict[str, float | str] | None:
    """Return the values of ``geometry.*`` that are stated."""
    from fden_ros.parameters import check

    stated: dict[str, float | str] = {}
    if args.sphere is not None:
        stated = {"kind": "sphere", "radius": args.sphere}
        stated |= {} if args.thickness is None else {"thickness": args.thickness}
    elif args.flat_punch is not None:
        stated = {"kind": "flat_punch", "area": args.flat_punch, "thickness": args.thickness}
    try:
        check({f"geometry.{name}": value for name, value in stated.items()})
    except InputError as error:
        args.parser.error(str(error))
    return stated or None


def _read(args: argparse.Namespace, robot: Robot | None) -> tuple[list[Reading], Survey]:
    from fden_ros.configure.reading import read
    from fden_ros.configure.robots import robot_selection
    from fden_ros.configure.survey import survey
    from fden_ros.recording.reader import BagReader
    from fden_ros.recording.source import is_table

    given = selection_of(args)
    readings: list[Reading] = []
    for path in args.recordings:
        selection = given
        if robot is not None and not is_table(path, given):
            selection = robot_selection(robot, BagReader(path).topics, given)
        readings.append(read(path, selection))
        kinds = {(r.streams.force.shape[1], r.streams.position.shape[1]) for r in readings}
        if len(kinds) > 1:
            raise InputError(
                f"{path} is of a different kind from {readings[0].path}: recordings of one "
                "rig have the same types"
            )
    return readings, survey(
        [reading.streams for reading in readings],
        _indenter(args),
        [str(path) for path in args.rigid],
        readings[0].units,
    )


def _show(found: Survey, readings: Sequence[Reading], *, briefly: bool) -> None:
    """Print what was found; `briefly` where a file says the rest."""
    from rich.console import Console
    from rich.markup import escape

    from fden_ros.configure.writer import value_text
    from fden_ros.report.table import table_of

    console = Console(highlight=False)
    for reading in readings:
        inputs = reading.inputs
        console.print(
            f"{reading.path}: force from {inputs['force']}, displacement from "
            f"{inputs['displacement']}",
            soft_wrap=True,
        )
        for warning in reading.warnings:
            console.print(f"[yellow]warning:[/yellow] {escape(warning)}", soft_wrap=True)
    stated = [finding for finding in found.findings if finding.claim]
    missing = [finding for finding in found.findings if not finding.claim]
    if briefly:
        for line in _brief_lines(stated):
            console.print(escape(line))
        if missing:
            names = ", ".join(finding.subject for finding in missing)
            console.print(f"not found: {names}; the file says what would show each")
        return
    rows = ((one.subject, escape(value_text(one)), escape(one.evidence)) for one in stated)
    console.print(table_of({"found": 20, "": 1, "by": 1}, rows))
    for one in missing:
        console.print(f"not found: {one.subject} ({escape(one.evidence)}): {one.motion}")


def _brief_lines(stated: Sequence[Finding]) -> list[str]:
    """Return the stated values, one line per quantity."""
    from fden_ros.configure.writer import value_text

    said: dict[str, list[str]] = {}
    for finding in stated:
        if finding.value is not None:
            quantity, _, aspect = finding.subject.partition(" ")
            said.setdefault(quantity, []).append(f"{aspect} {value_text(finding)}".strip())
    return [f"{quantity}: {', '.join(values)}" for quantity, values in said.items()]
