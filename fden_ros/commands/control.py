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

"""``fden control``: the force controller in closed loop, scheduled beside fixed gains."""

from __future__ import annotations

import argparse
from pathlib import Path

DESCRIPTION = """\
Close the loop of the reference force controller with simulated tissue and the real identification,
without ROS, on tissues from the softest to the stiffest of the paper's Table II: once with gains
scheduled by the live stiffness, once with fixed ones. On the way to the highest force the probe
meets a stiff inclusion. Prints a table; control.png lies in the output folder.

  fden control -o control            ten tissues, about a minute
  fden control -o control -n 3       three
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to ``fden``."""
    parser = subparsers.add_parser(
        "control",
        help="force control with live and with fixed gains, in simulation",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("control"), metavar="DIR", help="folder"
    )
    parser.add_argument("-n", "--tissues", type=int, default=10, metavar="N", help="how many")
    parser.add_argument("--seed", type=int, default=0, help="of the sensors' noise")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the comparison; return the exit code."""
    from rich.console import Console
    from rich.progress import track

    from fden_ros.benchmarks import closed_loop
    from fden_ros.benchmarks.closed_loop_picture import control_table, save_control_figure
    from fden_ros.errors import InputError

    if args.tissues < 1:
        raise InputError(f"{args.tissues} tissues; give at least one")
    program = closed_loop.Program()
    console = Console()
    pairs = []
    for model in track(
        closed_loop.tissues(args.tissues), "closing the loop", console=Console(stderr=True)
    ):
        fixed, live = (
            closed_loop.run(model, scheduled=scheduled, program=program, seed=args.seed)
            for scheduled in (False, True)
        )
        pairs.append((fixed, live))
    console.print(control_table(pairs, program))
    args.output.mkdir(parents=True, exist_ok=True)
    picture = args.output / "control.png"
    save_control_figure(pairs, program, picture)
    console.print(f"wrote {picture}")
    return 0
