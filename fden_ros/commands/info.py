# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden info``: what is in a bag, and what a replay would use of it."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from fden_ros.commands.command import Command, add_json, print_json
from fden_ros.commands.inputs import (
    add_input_options,
    add_recording,
    parameters_of,
    selection_of,
)

if TYPE_CHECKING:
    from fden_ros.recording.contents import BagContents, TopicContents

DESCRIPTION = """\
Read a bag through and show its topics: type, messages, frame, rate, jitter, gaps, and which of
them `fden replay` would take for force and displacement. Damage is reported, and what remains is
used. Of a table (CSV) the columns are shown.
"""

EPILOG = """\
examples:
  fden info palpation.mcap
  fden info palpation.mcap --json | jq '.topics[] | {name, rate_hz}'
  fden info palpation.mcap --force-topic /ft_sensor       would this do?

Rate and jitter are those of the header stamps, gaps left out. A gap is a step of more than 20 ms
and ten usual ones. Exit codes: 0 a replay can begin, 1 it cannot, 2 wrong usage.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    add_recording(parser)
    add_input_options(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Inspect and print; return 1 if a replay could not begin."""
    from fden_ros.recording.contents import inspect
    from fden_ros.recording.table import looks_like_a_table

    if looks_like_a_table(args.bag):
        return _show_table(args.bag, args.json)
    contents = inspect(args.bag, parameters_of(args), selection_of(args))
    if args.json:
        print_json(contents.as_object())
    else:
        _show(contents)
    for problem in contents.problems:
        print(f"fden info: {problem}", file=sys.stderr)
    return 1 if contents.problems else 0


def _show_table(path: Path, as_json: bool) -> int:
    from fden_ros.recording.table import guessed_columns, headings_of

    headings = headings_of(path)
    if as_json:
        return print_json({"columns": headings})
    print(f"{path}: a table with the columns")
    for number, heading in enumerate(headings, start=1):
        print(f"  {number:2}  {heading}")
    columns = "" if guessed_columns(headings) else " --columns TIME,FORCE,DISPLACEMENT"
    print(f"Next: fden replay {shlex.quote(str(path))}{columns}")
    return 0


def _show(contents: BagContents) -> None:
    uses: dict[str, list[str]] = {}
    for what, name in contents.used.items():
        topic, _, path = name.partition(" ")
        uses.setdefault(topic, []).append(f"{what} {path}".strip())
    for topic_contents in contents.topics:
        used = " and ".join(uses.get(topic_contents.name, []))
        print(topic_contents.name + (f"   <- {used}" if used else ""))
        print(f"    {_describe(topic_contents)}")
    filled = [topic for topic in contents.topics if topic.start_ns]
    if filled:
        length = max(t.end_ns for t in filled) - min(t.start_ns for t in filled)
        print(f"{sum(t.messages for t in filled)} messages in {length * 1e-9:.1f} s")
    for warning in contents.warnings:
        print(f"warning: {warning}")


def _describe(topic: TopicContents) -> str:
    parts = [topic.type.replace("/msg/", "/"), f"{topic.messages} messages"]
    if topic.rate_hz:
        parts.append(f"{topic.rate_hz:.4g} Hz, jitter {1e3 * topic.jitter_s:.2g} ms")
    if topic.gaps:
        parts.append(f"{topic.gaps} gaps, the longest {topic.longest_gap_s:.2g} s")
    if topic.stamped:
        parts.append(f"recorded {1e3 * topic.delay_s:.3g} ms after its stamps")
        parts.append(f"frame {topic.frame!r}")
    else:
        parts.append("no stamps")
    return ", ".join(parts)


COMMAND = Command(
    "info", "show what is in a bag and what would be used", DESCRIPTION, EPILOG, add_arguments, run
)
