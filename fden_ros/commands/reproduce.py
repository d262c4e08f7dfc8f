# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""``fden reproduce``: the paper's study, simulated, and what becomes of its claims."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

DESCRIPTION = """\
Simulate the paper's study through the model's closed forms, apply the paper's procedures, and
write to a folder: Tables I and II beside the paper's, its figures redrawn, and for each claim
whether it holds and by how much (report.md, report.json, *.png). Takes about a minute.
"""

EPILOG = """\
examples:
  fden reproduce -o study
  fden reproduce -o study --seed 7 --noise 0.5
"""

_SAMPLES = 64


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to ``fden``."""
    parser = subparsers.add_parser(
        "reproduce",
        help="simulate the paper's study and judge its claims",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="DIR", help="folder of the report"
    )
    parser.add_argument(
        "--seed", type=_count, default=1, metavar="N", help="of the random samples (default: 1)"
    )
    parser.add_argument(
        "--samples", type=_samples, default=_SAMPLES, metavar="N", help="(default: 64)"
    )
    parser.add_argument(
        "--noise",
        type=_factor,
        default=1.0,
        metavar="F",
        help="noise of the noisy half, times what gives the paper's R² (default: 1)",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Simulate, evaluate and write; return the exit code."""
    from rich.console import Console
    from rich.progress import Progress

    from fden_ros.errors import InputError
    from fden_ros.experiments.study import Noise, judge_claims, judge_numbers, run_study
    from fden_ros.experiments.study_report import Report

    try:
        args.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{args.output} cannot be made: {error.strerror}") from None
    noise = Noise().scaled(args.noise)
    with Progress(
        console=Console(stderr=True), disable=not sys.stderr.isatty(), transient=True
    ) as progress:
        task = progress.add_task("simulating and fitting", total=2 * args.samples)

        def advance() -> None:
            progress.advance(task)

        exact = run_study(args.seed, noise.scaled(0.0), args.samples, advance)
        noisy = run_study(args.seed, noise, args.samples, advance)
        progress.update(task, description="judging the claims", total=None)
        claims, numbers = judge_claims(exact, noisy, args.seed), judge_numbers(exact)
    Report(exact, noisy, claims, numbers, args.seed, noise).save(args.output)
    console = Console()
    for claim in claims:
        color = {"yes": "green", "no": "red"}.get(claim.holds, "yellow")
        console.print(
            f"[{color}]{claim.holds:>7}[/{color}]  {claim.claim}", highlight=False, soft_wrap=True
        )
    console.print(
        f"{len(numbers)} numbers or equations of the paper cannot be; "
        f"wrote {args.output / 'report.md'}",
        highlight=False,
        soft_wrap=True,
    )
    return 0


def _count(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} must not be negative")
    return value


def _samples(text: str) -> int:
    value = int(text)
    if value < 2:
        raise argparse.ArgumentTypeError(f"{text} is too few: give 2 or more")
    return value


def _factor(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= 3.0:
        raise argparse.ArgumentTypeError(f"{text} must lie between 0 and 3")
    return value
