# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden report``: a page that a person reads, from a recording."""

from __future__ import annotations

import argparse
import sys

from fden_ros.commands.command import write
from fden_ros.commands.inputs import (
    parameters_of,
    selection_of,
)

DESCRIPTION = """\
Replay a recording and write a page about it: the stiffness first, then a table
and a comparison of the contacts, with a map if there are positions. Each
contact has force and depth, the fitted law with its band, the estimates as
they converge, and the classification. The page says what the data cannot show.
It is one file that loads nothing from a network, for light and dark screens
and for print.
"""

EPILOG = """\
examples:
  fden report palpation.mcap --config probe.yaml -o report.html
  fden report palpation.mcap --config probe.yaml        print only its first sentences

For a table with one row per contact: fden batch palpation.mcap --config
probe.yaml -o contacts.csv
"""


def run(args: argparse.Namespace) -> int:
    """Print the sentence, and write the page; return the exit code."""
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
    for warning in session.replay.warnings:
        print(f"warning: {warning}", file=sys.stderr)
    return 0
