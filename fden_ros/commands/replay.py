"""``fden replay``: estimates from a recorded bag, straight from the file."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

DESCRIPTION = """\
Run the identification on a recorded bag, without DDS: the same pipeline as the live node, so the
numbers are the same to the last bit. Prints a table, or with --json one object on standard output.
"""

EPILOG = """\
examples:
  fden replay ramp_bag --config ramp_bag/identifier.yaml
  fden replay palpation.mcap --force-topic /ft_sensor --displacement-topic /robot/pose --config
  probe.yaml fden replay ramp_bag --config probe.yaml --json | jq '.contacts[].g'

The configuration is the identifier node's own parameter file. Exit codes: 0 done, 1 the input
cannot be used, 2 wrong usage.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to ``fden``."""
    parser = subparsers.add_parser(
        "replay",
        help="estimate from a recorded bag",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="a rosbag2 folder or an .mcap file")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="parameter file of the identifier (YAML)"
    )
    parser.add_argument("--force-topic", metavar="T", help="topic of the force")
    parser.add_argument("--displacement-topic", metavar="T", help="topic of the displacement")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Replay and print; return the exit code."""
    from rich.console import Console

    from fden_ros.parameters import check, read_parameter_file
    from fden_ros.replay import replay, result_object
    from fden_ros.report.table import contact_table

    parameters = read_parameter_file(args.config) if args.config else check({})
    result = replay(
        args.bag,
        parameters,
        force_topic=args.force_topic,
        displacement_topic=args.displacement_topic,
        progress=sys.stderr.isatty(),
    )
    if args.json:
        json.dump(result_object(result), sys.stdout, allow_nan=False)
        print()
        return 0
    console = Console()
    console.print(contact_table(result.summaries))
    console.print(f"{result.samples} samples, {sum(result.rejected.values())} rejected")
    for reason, count in result.rejected.items():
        console.print(f"  {reason}: {count}")
    for warning in result.warnings:
        console.print(f"[yellow]warning:[/yellow] {warning}")
    return 0
