# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden report``: a page that a person reads, from a recording."""

from __future__ import annotations

import argparse
import csv
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from fden_ros.commands.command import Command, write
from fden_ros.commands.inputs import (
    add_input_options,
    add_recording,
    parameters_of,
    selection_of,
)

if TYPE_CHECKING:
    from fden_ros.offline.session import Session

DESCRIPTION = """\
Replay a recording and write a page on it: what was pressed, where and how often; per contact force
and depth, the fitted law with its band, the estimates converging, the innovations with their test,
the classification; across contacts a comparison, and a map where there are positions. What the
data do not allow to conclude is said in words. One file, no network; light, dark and print.
"""

EPILOG = """\
examples:
  fden report palpation.mcap --config probe.yaml -o report.html
  fden report palpation.mcap --config probe.yaml --csv contacts.csv

Exit codes: 0 done, 1 the input cannot be used, 2 wrong usage.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    add_recording(parser)
    parser.add_argument("-o", "--output", type=Path, metavar="FILE", help="the page, HTML")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="a table, one row a contact")
    add_input_options(parser)


def run(args: argparse.Namespace) -> int:
    """Write what was asked for; return the exit code."""
    if args.output is None and args.csv is None:
        args.parser.error("nothing to write: give -o FILE.html or --csv FILE")
    from fden_ros.offline.session import gather
    from fden_ros.report.sentence import sentence

    session = gather(
        args.bag, parameters_of(args), selection_of(args), progress=sys.stderr.isatty()
    )
    print(sentence(session))
    if args.output is not None:
        from fden_ros.report.page import page

        text = page(session)
        write(args.output, lambda path: path.write_text(text, encoding="utf-8"))
        print(f"wrote {args.output}")
    if args.csv is not None:
        write(args.csv, lambda path: _save_table(session, path))
        print(f"wrote {args.csv}")
    for warning in session.replay.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    return 0


def _save_table(session: Session, path: Path) -> None:
    from fden_ros.offline.rows import COLUMNS, session_rows

    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, ("recording", *COLUMNS), lineterminator="\n")
        writer.writeheader()
        writer.writerows(session_rows(session))


COMMAND = Command("report", "write a page on a recording", DESCRIPTION, EPILOG, add_arguments, run)
