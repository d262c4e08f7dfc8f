# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden calibrate rig``: what contacts on tissue tell of the rig."""

from __future__ import annotations

import argparse
from pathlib import Path

from fden_ros.commands.command import Command, add_json, print_json, write
from fden_ros.commands.inputs import (
    add_input_options,
    add_recording,
    parameters_of,
    selection_of,
)

DESCRIPTION = "Measure what has to be known of a rig; `fden configure` finds all but friction."

EPILOG = """\
examples:
  fden calibrate rig session_bag --config arm.yaml -o arm_learned.yaml
"""

RIG_DESCRIPTION = """\
Learn delay and friction from contacts on any tissue, as the node does while it runs: what one
contact tells, the next one knows. Print what is known after the last, as parameters.
"""

RIG_EPILOG = """\
examples:
  fden calibrate rig session_bag --config arm.yaml -o arm_learned.yaml
  fden calibrate rig session_bag --json | jq .parameters

Recording: ten touches or so at different places, each with a hold and a release. The compliance is
not learned: measure it against something rigid.
Exit codes: 0 done, 1 the input cannot be used, 2 wrong usage.
"""


def add_rig_arguments(parser: argparse.ArgumentParser) -> None:
    """Add those of ``fden calibrate rig``."""
    add_recording(parser)
    add_input_options(parser)
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="write a parameter file: that of --config with what was learned",
    )
    add_json(parser)


def run_rig(args: argparse.Namespace) -> int:
    """Learn the rig and print it; return the exit code."""
    from fden_ros.offline.rig import learn_rig, learned_parameters, parameter_text

    parameters = parameters_of(args)
    rig = learn_rig(args.bag, parameters, selection_of(args))
    learned = learned_parameters(rig, parameters)
    if args.output is not None:
        text = parameter_text(parameters.changed(learned))
        write(args.output, lambda path: path.write_text(text, encoding="utf-8"))
    if args.json:
        return print_json({"contacts": rig.contacts, "parameters": learned})
    values = rig.values
    print(f"{rig.contacts} contacts tell of the rig, beside what the parameters say:")
    for name, unit in (("delay", "ms"), ("friction", "mN")):
        value = values[name]
        print(f"  {name:<11}{1e3 * value.mean:8.3f} ± {1e3 * value.sd:.3f} {unit}")
    for name, number in learned.items():
        print(f"Parameter: {name}: {number:.4g}")
    return 0


COMMAND = Command(
    "calibrate",
    "what the contacts of a recording tell of the rig",
    DESCRIPTION,
    EPILOG,
    parts=(
        Command(
            "rig",
            "delay and friction that the contacts of a recording tell",
            RIG_DESCRIPTION,
            RIG_EPILOG,
            add_rig_arguments,
            run_rig,
        ),
    ),
)
