# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden bag``: make a synthetic palpation bag."""

from __future__ import annotations

import argparse
import shlex

from fden_ros.commands.checkout import module
from fden_ros.errors import InputError

DESCRIPTION = """\
Simulate a palpation and write it as a rosbag2 folder (MCAP), which `ros2 bag
play`, Foxglove and PlotJuggler also read. The bag has the truth as JSON on the
latched topic /simulation/truth. The folder has a parameter file for the
identifier, identifier.yaml. This command needs a checkout, because the
simulation is not installed.
"""

EPILOG = """\
examples:
  fden bag --list                       list the scenarios
  fden bag ramp -o ramp_bag             three sites, pressed once each
  fden bag ramp -o ramp_bag --seed 7 --force
                                        other tissue and noise, replacing the bag
  fden bag my_scenario.yaml -o my_bag   a scenario of your own; bags/*.yaml show the format
"""


def run(args: argparse.Namespace) -> int:
    """Make the bag, or list the scenarios; return the exit code."""
    if args.list:
        return _list_scenarios()
    if args.scenario is None or args.output is None:
        args.parser.error("give SCENARIO and -o DIR, or --list to see the scenarios")
    writer = module("simulation.bag")
    scenario = module("simulation.scenario").load_scenario(args.scenario)
    recording = module("simulation.simulate").simulate(scenario, args.seed)
    bag = writer.write_recording(recording, args.output, overwrite=args.force)
    truth = recording.truth
    duration = ((bag.end_ns or 0) - (bag.start_ns or 0)) * 1e-9
    print(
        f"{args.output}: {truth['scenario']}, seed {truth['seed']}, {duration:.1f} s, "
        f"{len(truth['sites'])} sites, {len(truth['contacts'])} contacts"
    )
    for topic in bag.topics:
        print(f"  {topic.name:24} {topic.type_name:32} {topic.message_count:>8}")
    folder, config = (
        shlex.quote(str(p)) for p in (args.output, args.output / writer.PARAMETER_FILE)
    )
    print(f"Next: fden replay {folder} --config {config}")
    return 0


def _list_scenarios() -> int:
    scenarios = module("simulation.scenario")
    names = scenarios.scenario_names()
    if not names:
        raise InputError("no scenario is installed: give the path of a YAML file instead")
    width = max(map(len, names))
    for name in names:
        print(f"{name:{width}}  {scenarios.load_scenario(name).description}".rstrip())
    return 0
