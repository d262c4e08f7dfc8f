# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden play``: publish a bag on live topics."""

from __future__ import annotations

import argparse
import math
import sys
import time

from fden_ros.commands.command import positive
from fden_ros.errors import InputError

DESCRIPTION = """\
Publish a bag on live topics: the recorded bytes, at the recorded pace, with the quality of service
that the recorded publishers offered. Playing begins when every force and displacement topic has a
subscriber, and ends when reliable subscribers have received everything.
"""

EPILOG = """\
examples:
  fden play ramp_bag                            as recorded
  fden play ramp_bag --rate 5                   five times faster
  fden play ramp_bag --remap /force:=/ft/wrench /displacement:=/arm/joints
  fden play ramp_bag --loop --no-wait           again and again, with the same stamps, until Ctrl-C

`--rate inf` sends 4000 messages a second: subscribers need deep queues. `fden replay` is faster.
"""

#: Between finding the subscribers and the first message [s].
_PAUSE = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    parser.add_argument("bag", metavar="BAG", help="a bag: a folder, an .mcap, .db3 or .bag file")
    parser.add_argument(
        "--rate",
        type=_positive_or_inf,
        default=1.0,
        metavar="R",
        help="speed, or inf (default: 1)",
    )
    parser.add_argument("--loop", action="store_true", help="play again and again")
    parser.add_argument(
        "--remap",
        type=_remapping,
        nargs="+",
        action="extend",
        default=[],
        metavar="FROM:=TO",
        help="publish a topic under another name",
    )
    parser.add_argument("--no-wait", action="store_true", help="begin without subscribers")


def run(args: argparse.Namespace) -> int:
    """Play the bag; return the exit code."""
    from fden_ros.nodes.player import Player
    from fden_ros.progress import progress
    from fden_ros.recording.reader import BagReader

    bag = BagReader(args.bag)
    player = Player(bag, rate=args.rate, remap=dict(args.remap))
    if player.message_count == 0:
        raise InputError(f"{args.bag} holds no message to play: choose another bag")
    for warning in (*bag.warnings, *player.warnings):
        _say(f"warning: {warning}")
    shown = len(player.warnings)
    with player:
        if not args.no_wait and player.input_topics:
            player.wait_for_subscribers(
                on_wait=lambda lacking: _say(f"waiting for a subscriber to {lacking} ...")
            )
            time.sleep(_PAUSE)
        while True:
            began = time.monotonic()
            with progress("playing [s]", player.duration_s) as show:
                sent = player.play(lambda sent, elapsed_s: show(elapsed_s))
            _say(f"sent {sent} messages in {time.monotonic() - began:.1f} s")
            if not args.loop:
                break
    for warning in player.warnings[shown:]:
        _say(f"warning: {warning}")
    return 0


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _positive_or_inf(text: str) -> float:
    return math.inf if text == "inf" else positive(text)


def _remapping(text: str) -> tuple[str, str]:
    old, separator, new = text.partition(":=")
    if not (old and separator and new):
        raise argparse.ArgumentTypeError(f"expected FROM:=TO, got {text!r}")
    return old, new
