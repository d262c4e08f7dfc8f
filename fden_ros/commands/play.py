# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden play``: publish a bag on live topics."""

from __future__ import annotations

import argparse
import sys

DESCRIPTION = "Publish a bag on live topics; on a robot use ros2 bag play.\n"
EPILOG = "examples:\n  fden play ramp_bag --rate 5 --remap /force:=/ft/wrench\n"


def run(args: argparse.Namespace) -> int:
    """Play the bag; return the exit code."""
    from fden_ros.nodes.player import play, problem_of
    from fden_ros.recording.reader import BagReader

    bag = BagReader(args.bag)
    for warning in (*bag.warnings, *filter(None, map(problem_of, bag.topics))):
        print(f"warning: {warning}", file=sys.stderr)
    print(f"sent {play(bag, args.rate, dict(args.remap))} messages", file=sys.stderr)
    return 0
