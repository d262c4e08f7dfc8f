# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden replay``: estimates from a recording, straight from the file."""

from __future__ import annotations

import argparse
import signal
import sys
from typing import TYPE_CHECKING

from fden_ros.commands.command import print_json
from fden_ros.commands.inputs import (
    parameters_of,
    selection_of,
)

if TYPE_CHECKING:
    from fden_ros.offline.replay import Replay
    from fden_ros.parameters import Parameters

_NOTHING_IDENTIFIED = 3

DESCRIPTION = """\
Identify the tissue of a recording, without DDS. The pipeline is that of the
live node, so the numbers are the same to the last bit. The command prints a
table, or one object with --json. With -o it also writes a bag with everything
that the node would have published.
"""

EPILOG = """\
examples:
  fden replay ramp_bag --config ramp_bag/identifier.yaml
  fden replay ramp_bag --config probe.yaml --json | jq '.contacts[].g'
  fden replay palpation.mcap --config probe.yaml \\
      --force-topic /ft_sensor --displacement-topic /robot/pose
  fden replay palpation.mcap --config probe.yaml \\
      --force-topic /plc/loads --force-field 'channels[2]'
  fden replay palpation.mcap --config probe.yaml -o results
      then: ros2 bag play -i palpation.mcap mcap -i results
  fden replay press.csv --config probe.yaml --columns '1,3,2*1e-3'

The node identifier reads the same parameter file.
"""

#: What its exit codes say next to those of all commands.
EXIT_CODES = {
    0: "a contact is converged, or N/m or a slope is known",
    _NOTHING_IDENTIFIED: "nothing was identified (the last line says why)",
}


def run(args: argparse.Namespace) -> int:
    """Replay and print; return the exit code."""
    from fden_ros.offline.replay import replay

    if args.output is None and args.force:
        args.parser.error("--force replaces OUT: give -o OUT too")
    parameters, selection = parameters_of(args), selection_of(args)
    progress = sys.stderr.isatty()
    if args.output is None:
        result = replay(args.bag, parameters, selection, progress=progress)
        return _shown(result, args.json)
    from fden_ros.offline.results import replay_to_bag

    # As with Ctrl-C, the unfinished output is removed.
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    result = replay_to_bag(
        args.bag,
        parameters,
        selection,
        args.output,
        overwrite=args.force,
        progress=progress,
    )
    code = _shown(result, args.json)
    if not args.json:
        print(f"wrote {args.output}")
    return code


def _shown(result: Replay, as_json: bool) -> int:
    """Print a replay; return the exit code."""
    parameters = result.parameters
    lacking = _lacking(result, parameters)
    _show(result, lacking, as_json)
    if result.has_identified:
        return 0
    why = "no contact has converged"
    if parameters.core.is_continuous:
        why = "no stiffness along the path: the probe must oscillate while it slides"
    elif result.has_strokes:
        why = next(words for words in result.warnings if "strokes" in words)
    elif result.warnings and (
        result.is_air_doubted or not (result.summaries and result.summaries[-1].estimate)
    ):
        # What is wrong with the input comes first.
        why += f"; {result.warnings[0]}"
    elif lacking:
        # The last contact of a place lacks least.
        why += f"; {lacking[-1]}"
    print(f"fden: nothing was identified: {why}", file=sys.stderr)
    return _NOTHING_IDENTIFIED


def _lacking(result: Replay, parameters: Parameters) -> list[str]:
    """Return what the contacts lack that have not converged, a line each."""
    from fden_ros.offline.advice import against_the_law, shortfall
    from fden_ros.offline.known import known_alone
    from fden_ros.parameters import pipeline_config

    if parameters.core.is_continuous or result.has_strokes:
        return []
    config = pipeline_config(parameters)
    lines = []
    for summary in result.summaries:
        words = shortfall(summary, config)
        if summary.contact_id in result.with_stiffness_alone:
            words = f"{known_alone(summary)} is known; G and Gn are not known: " + (
                words or against_the_law(summary)
            )
        if words:
            lines.append(f"contact {summary.contact_id}: {words}")
    return lines


def _show(result: Replay, lacking: list[str], as_json: bool) -> None:
    from rich.console import Console
    from rich.markup import escape

    from fden_ros.offline.replay import result_object
    from fden_ros.report.numbers import slope_words
    from fden_ros.report.table import contact_table

    if as_json:
        print_json(result_object(result))
        return
    console = Console()
    if result.has_strokes:
        console.print(
            f"no table: {len(result.summaries)} contacts, perhaps strokes that never lift"
        )
    else:
        console.print(contact_table(result.summaries, result.with_stiffness_alone))
    if unseen := result.measured_unseen.loading:
        console.print(f"no contact, but a measured slope: {slope_words(unseen)}")
    used = ", ".join(f"{stream} from {name}" for stream, name in result.inputs.items())
    console.print(
        f"{result.samples:,} samples, {sum(result.rejected.values()):,} rejected; {escape(used)}"
    )
    for line in result.set_by_recording:
        console.print(f"set by the recording: {escape(line)}")
    for reason, count in result.rejected.items():
        console.print(f"  {reason}: {count:,}")
    for words in lacking:
        console.print(escape(words))
    for warning in result.warnings:
        console.print(f"[yellow]warning:[/yellow] {escape(warning)}")
