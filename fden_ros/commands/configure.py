# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden configure``: a parameter file from recordings of a probe nobody has configured."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fden_ros.commands.command import Command, add_json, print_json, write
from fden_ros.commands.inputs import add_selection_options, selection_of
from fden_ros.errors import InputError

if TYPE_CHECKING:
    from fden_ros.configure.reading import Reading
    from fden_ros.configure.robots import Robot
    from fden_ros.configure.survey import Survey

DESCRIPTION = """\
Find out what a recording tells of a probe: axes and signs, units, rates, noise, bias, drift, the
delay between force and displacement, the compliance and the weight of the tool. Each finding says
how sure it is and which seconds it rests on; what the recording cannot tell it says, with the
motion that would. The parameter file that comes out is commented.
"""

EPILOG = """\
examples:
  fden configure palpation.mcap -o probe.yaml --flat-punch 3.14e-4 --thickness 0.02
  fden configure plate.mcap tissue.mcap --rigid plate.mcap -o probe.yaml --plot evidence.png
  fden configure robot.csv --columns @500,5,3*1e-3        500 Hz, force and depth by number
  fden configure --live --robot ur -o probe.yaml          what to do, step by step
  fden configure press.csv --json | jq '.findings[] | select(.claim == false)'

A recording that tells everything: 2 s in the air; the tool turned through three orientations; a
rigid plate pressed twice; three presses of tissue with a hold of 2 s, in the air in between; a
sine of 0.5 mm in tissue at 1 and 4 Hz. No recording tells the indenter: state it.
Exit codes: 0 a file was proposed, 1 the input cannot be used, 2 wrong usage.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    parser.add_argument(
        "recordings",
        type=Path,
        nargs="*",
        metavar="RECORDING",
        help="rosbag2 folders, .mcap files or tables of one rig",
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="parameter file to write"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE", help="picture of the evidence")
    parser.add_argument(
        "--live",
        action="store_true",
        help="listen to the robot instead, say what to do next, step by step, and wait for it",
    )
    parser.add_argument(
        "--patience",
        type=float,
        default=120.0,
        metavar="S",
        help="live: go on without a step after this time [s] (default: %(default)g)",
    )
    parser.add_argument(
        "--robot",
        metavar="NAME",
        help="topics and conventions of a known robot: crtk, franka, kuka_iiwa, ros2_control, ur, "
        "xarm; without a recording: a file from its conventions alone",
    )
    add_json(parser)
    parser.add_argument(
        "--rigid",
        type=Path,
        action="append",
        default=[],
        metavar="RECORDING",
        help="one of the recordings: in it something rigid was pressed",
    )
    indenter = parser.add_argument_group("the indenter, which no recording shows")
    indenter.add_argument("--flat-punch", type=float, metavar="AREA", help="face [m^2]")
    indenter.add_argument("--thickness", type=float, metavar="H", help="of the tissue [m]")
    indenter.add_argument("--sphere", type=float, metavar="R", help="radius of the tip [m]")
    add_selection_options(parser)


def run(args: argparse.Namespace) -> int:
    """Read, find out, print and write; return the exit code."""
    from fden_ros.configure.robots import robot_named, robot_notes
    from fden_ros.configure.writer import parameter_file, replay_command, replay_problems

    stated, geometry = _indenter(args)
    robot = robot_named(args.robot) if args.robot else None
    if args.live and args.recordings:
        args.parser.error("--live listens to topics: name no recording")
    if not args.recordings and not args.live:
        if robot is not None:
            return _from_conventions(args.output, robot)
        args.parser.error("name a recording, or a robot with --robot")
    unknown = [str(path) for path in args.rigid if path not in args.recordings]
    if unknown:
        args.parser.error(f"--rigid {unknown[0]} is none of the recordings")
    if args.live:
        readings, found = _listen(args, robot, stated, geometry)
    else:
        readings = _read(args, robot)
        found = _survey(readings, stated, geometry, [str(path) for path in args.rigid])
    notes = robot_notes(robot, found) if robot is not None else []
    if args.output is not None:
        text = parameter_file(found, readings, notes)
        write(args.output, lambda path: path.write_text(text, encoding="utf-8"))
    if args.plot is not None:
        from fden_ros.configure.picture import save_picture

        write(args.plot, lambda path: save_picture(found, path))
    if args.json:
        return print_json(result_object(found, readings))
    _show(found, readings, briefly=args.output is not None)
    for note in notes:
        print(f"note: {note}")
    for problem in replay_problems(found, readings):
        print(f"ATTENTION: {problem}")
    if args.plot is not None:
        print(f"wrote {args.plot}")
    if args.output is not None and args.live:
        print(f"wrote {args.output}")
        print(f"Next: ros2 launch fden_ros identifier.launch.py parameters:={args.output}")
    elif args.output is not None:
        print(f"wrote {args.output}")
        print(f"Next: {replay_command(str(args.output), readings[-1])}")
    else:
        print("Next: the same with -o probe.yaml")
    return 0


def result_object(found: Survey, readings: Sequence[Reading]) -> dict[str, Any]:
    """Return what ``--json`` prints."""
    from fden_ros.configure.writer import parameter_values, replay_problems

    return {
        "inputs": [
            {"recording": str(r.path), **r.inputs, "types": r.types, "joints": r.joints}
            for r in readings
        ],
        "findings": [
            {
                "subject": f.subject,
                "claim": f.claim,
                "value": list(f.value) if isinstance(f.value, tuple) else f.value,
                "deviation": f.deviation,
                "unit": f.unit,
                "seconds": [list(span) for span in f.seconds],
                "evidence": f.evidence,
                "motion": f.motion,
            }
            for f in found.findings
        ],
        "parameters": parameter_values(found, readings),
        "problems": replay_problems(found, readings),
    }


def _indenter(args: argparse.Namespace) -> tuple[dict[str, float | str] | None, Any]:
    from fden_ros.parameters import check, geometry_of

    if args.sphere is not None and (args.flat_punch is not None or args.thickness is not None):
        args.parser.error("--sphere and --flat-punch exclude each other")
    if (args.flat_punch is None) != (args.thickness is None):
        args.parser.error("--flat-punch AREA needs --thickness H, and the other way round")
    stated: dict[str, float | str] = {}
    if args.sphere is not None:
        stated = {"kind": "sphere", "radius": args.sphere}
    elif args.flat_punch is not None:
        stated = {"kind": "flat_punch", "area": args.flat_punch, "thickness": args.thickness}
    else:
        return None, None
    try:
        parameters = check({f"geometry.{name}": value for name, value in stated.items()})
    except InputError as error:
        args.parser.error(str(error))
    return stated, geometry_of(parameters)


def _from_conventions(output: Path | None, robot: Robot) -> int:
    from fden_ros.configure.robots import robot_file

    text = robot_file(robot)
    if output is None:
        print(text, end="")
        return 0
    write(output, lambda path: path.write_text(text, encoding="utf-8"))
    print(f"wrote {output}")
    print(f"Next: record a press, then fden configure --robot {robot.name} RECORDING")
    return 0


def _read(args: argparse.Namespace, robot: Robot | None) -> list[Reading]:
    from fden_ros.configure.reading import read
    from fden_ros.configure.robots import robot_selection
    from fden_ros.recording.reader import BagReader
    from fden_ros.recording.table import looks_like_a_table

    given = selection_of(args)
    readings = []
    for path in args.recordings:
        selection = given
        is_table = given.columns is not None or looks_like_a_table(path)
        if robot is not None and not is_table:
            selection = robot_selection(robot, str(path), BagReader(path).topics, given)
        readings.append(read(path, selection))
    first = readings[0].streams
    for reading in readings[1:]:
        streams = reading.streams
        if (
            streams.force.shape[1] != first.force.shape[1]
            or streams.position.shape[1] != first.position.shape[1]
        ):
            raise InputError(
                f"{reading.path} is of another kind than {readings[0].path}: recordings of one "
                "rig have the same types"
            )
    return readings


def _listen(
    args: argparse.Namespace,
    robot: Robot | None,
    stated: dict[str, float | str] | None,
    geometry: Any,
) -> tuple[list[Reading], Survey]:
    from fden_ros.nodes.guide import listen

    reading, found = listen(
        selection_of(args),
        robot,
        lambda reading: _survey([reading], stated, geometry, []),
        lambda line: print(line, file=sys.stderr, flush=True),
        args.patience,
    )
    return [reading], found


def _survey(
    readings: Sequence[Reading], stated: dict[str, float | str] | None, geometry: Any, rigid: Any
) -> Survey:
    from rich.console import Console

    from fden_ros.configure.survey import survey

    streams = [reading.streams for reading in readings]
    console = Console(stderr=True)
    if not sys.stderr.isatty():
        return survey(streams, stated, geometry, rigid)
    with console.status("looking") as status:
        return survey(streams, stated, geometry, rigid, status.update)


def _show(found: Survey, readings: Sequence[Reading], *, briefly: bool) -> None:
    """Print what was found; `briefly` where a file says the rest."""
    from rich.console import Console
    from rich.markup import escape

    from fden_ros.configure.writer import value_text
    from fden_ros.report.table import table_of

    console = Console()
    for reading in readings:
        console.print(
            f"{reading.path}: force from {reading.inputs['force']}, displacement from "
            f"{reading.inputs['displacement']}",
            highlight=False,
            soft_wrap=True,
        )
        for warning in reading.warnings:
            console.print(f"[yellow]warning:[/yellow] {escape(warning)}", soft_wrap=True)
    if briefly:
        for line in _brief_lines(found):
            console.print(escape(line), highlight=False)
        return
    rows = (
        (finding.subject, escape(value_text(finding)), escape(finding.evidence))
        for finding in found.findings
        if finding.claim
    )
    console.print(table_of({"found": 20, "": 1, "by": 1}, rows))
    missing = [finding for finding in found.findings if not finding.claim]
    for motion in dict.fromkeys(finding.motion for finding in missing):
        same = [finding for finding in missing if finding.motion == motion]
        names = ", ".join(finding.subject for finding in same)
        because = "; ".join(dict.fromkeys(finding.evidence for finding in same))
        console.print(f"cannot tell {names} ({escape(because)}): {motion}", highlight=False)


def _brief_lines(found: Survey) -> list[str]:
    """Return what is stated, a line a quantity, and what is not."""
    from fden_ros.configure.writer import value_text

    stated: dict[str, list[str]] = {}
    for finding in found.findings:
        if finding.claim and finding.value is not None:
            quantity, _, what = finding.subject.partition(" ")
            stated.setdefault(quantity, []).append(f"{what} {value_text(finding)}".strip())
    lines = [f"{quantity}: {', '.join(values)}" for quantity, values in stated.items()]
    missing = [finding.subject for finding in found.findings if not finding.claim]
    if missing:
        lines.append(f"cannot tell: {', '.join(missing)}; the file says what would")
    return lines


COMMAND = Command(
    "configure",
    "propose a parameter file from recordings of an unknown probe",
    DESCRIPTION,
    EPILOG,
    add_arguments,
    run,
)
