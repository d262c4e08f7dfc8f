# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden reproduce``: the paper's study, simulated, and evaluated by the paper's procedures."""

from __future__ import annotations

import argparse
from pathlib import Path

from fden_ros.commands.command import Command, number

DESCRIPTION = """\
Simulate the paper's study through the model's closed forms, apply the paper's procedures, and
write to a folder Tables I and II beside the paper's and its figures redrawn (report.md,
report.json, *.png). Takes about half a minute. Which of the paper's claims hold, and by how much,
is in docs/experiments.md.
"""

EPILOG = """\
examples:
  fden reproduce -o study
  fden reproduce -o study --seed 7 --noise 0.5
"""

_SAMPLES = 64


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="DIR", help="folder of the report"
    )
    parser.add_argument(
        "--seed",
        type=number(least=0, whole=True),
        default=1,
        metavar="N",
        help="of the random samples (default: 1)",
    )
    parser.add_argument(
        "--samples",
        type=number(least=2, whole=True),
        default=_SAMPLES,
        metavar="N",
        help="(default: 64)",
    )
    parser.add_argument(
        "--noise",
        type=number(least=0.0, below=4.0),
        default=1.0,
        metavar="F",
        help="noise of the noisy half, times what gives the paper's R² (default: 1)",
    )


def run(args: argparse.Namespace) -> int:
    """Simulate, evaluate and write; return the exit code."""
    from fden_ros.errors import InputError
    from fden_ros.experiments.study import Noise, run_study
    from fden_ros.experiments.study_report import Report
    from fden_ros.report.progress import progress

    try:
        args.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{args.output} cannot be made: {error.strerror}") from None
    noise = Noise().scaled(args.noise)
    with progress("simulating and fitting", 2 * args.samples) as advance:
        exact = run_study(args.seed, noise.scaled(0.0), args.samples, advance)
        noisy = run_study(args.seed, noise, args.samples, advance)
    Report(exact, noisy, args.seed, noise).save(args.output)
    print(f"wrote {args.output / 'report.md'}")
    return 0


COMMAND = Command(
    "reproduce",
    "simulate the paper's study",
    DESCRIPTION,
    EPILOG,
    add_arguments,
    run,
)
