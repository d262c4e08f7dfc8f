# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden calibrate``: what has to be known of sensors and robot before tissue is identified."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fden_ros.commands.command import Command, add_json, print_json, write
from fden_ros.commands.inputs import (
    add_input_options,
    add_recording,
    parameters_of,
    selection_of,
)

if TYPE_CHECKING:
    from fden_ros.configure.oscillations import DelayResult

DESCRIPTION = "Measure what has to be known of sensors and robot before tissue is identified."

EPILOG = """\
examples:
  fden calibrate delay sweep         from oscillations at two frequencies
  fden calibrate rig session_bag --config arm.yaml -o arm_learned.yaml
"""

DELAY_DESCRIPTION = """\
Find the delay between the stamps of force and displacement, from oscillations of the probe on
tissue. The force leads by pi alpha / 2 of the tissue, and by 2 pi f times the delay: two
frequencies tell the two apart, or a known alpha does. With one frequency and no alpha the delay is
printed as a function of alpha.
"""

DELAY_EPILOG = """\
examples:
  fden bag delay_two_frequencies -o sweep && fden calibrate delay sweep
  fden calibrate delay sine_bag --alpha 0.131 --alpha-sd 0.011
  fden calibrate delay robot.csv --columns @500,5,3*1e-3     500 Hz, force and depth by number
  fden calibrate delay sweep --json | jq .delay_s

Recording: press to a mean depth, wait a second, and move in a sine of some 10 cycles that does not
lift off; once at 1 Hz and once at 4 Hz, say. The answer is the parameter displacement.delay.
Exit codes: 0 done, 1 the input cannot be used, 2 wrong usage.
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

_ORDERS = (0.0, 0.05, 0.1, 0.131, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4)


def add_delay_arguments(parser: argparse.ArgumentParser) -> None:
    """Add those of ``fden calibrate delay``."""
    add_recording(parser)
    add_input_options(parser)
    parser.add_argument("--alpha", type=float, metavar="A", help="alpha of the tissue, if known")
    parser.add_argument(
        "--alpha-sd", type=float, default=0.0, metavar="S", help="its standard deviation"
    )
    add_json(parser)


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


def run(args: argparse.Namespace) -> int:
    """Find the delay and print it; return the exit code."""
    if args.alpha is not None and not 0.0 <= args.alpha < 1.0:
        args.parser.error(f"argument --alpha: expected 0 to 1, got {args.alpha}")
    if not (math.isfinite(args.alpha_sd) and args.alpha_sd >= 0.0):
        args.parser.error(f"argument --alpha-sd: expected 0 or more, got {args.alpha_sd}")
    from fden_ros.configure.oscillations import find_delay, read_samples

    force, displacement = read_samples(args.bag, parameters_of(args), selection_of(args))
    result = find_delay(force, displacement, args.alpha, args.alpha_sd)
    if args.json:
        return print_json(result_object(result))
    _show(result)
    return 0


def result_object(result: DelayResult) -> dict[str, Any]:
    """Return what ``--json`` prints."""
    return {
        "delay_s": result.delay,
        "delay_sd_s": result.delay_sd,
        "alpha": result.order,
        "alpha_sd": result.order_sd,
        "alpha_given": result.order_given,
        "slope": result.slope,
        "slope_sd": result.slope_sd,
        "explanations": [
            {"if": e.words, "delay_s": e.delay, "delay_sd_s": e.delay_sd}
            for e in result.explanations
        ],
        "oscillations": [
            {
                "start_s": o.start,
                "end_s": o.end,
                "frequency_hz": o.frequency,
                "amplitude_m": o.amplitude,
                "lead_deg": math.degrees(o.lead),
                "lead_sd_deg": math.degrees(o.lead_sd),
                "delay_s_by_alpha": {str(order): o.delay(order) for order in _ORDERS},
            }
            for o in result.oscillations
        ],
        "warnings": list(result.warnings),
    }


def _show(result: DelayResult) -> None:
    from rich.console import Console

    from fden_ros.report.table import table_of

    console = Console()
    rows = (
        (
            f"{o.start:.2f} s",
            f"{o.end:.2f} s",
            f"{o.frequency:.4g} Hz",
            f"{1e3 * o.amplitude:.3g} mm",
            f"{math.degrees(o.lead):.2f}° ± {math.degrees(o.lead_sd):.2f}°",
        )
        for o in result.oscillations
    )
    columns = ("from", "to", "frequency", "amplitude", "force leads by")
    console.print(table_of(dict.fromkeys(columns, 0), rows, "Oscillations"))
    for warning in result.warnings:
        console.print(f"[yellow]warning:[/yellow] {warning}", soft_wrap=True)
    if result.slope is not None and result.slope_sd is not None:
        console.print(
            f"The force grows with the frequency to the power {result.slope:.3f} ± "
            f"{result.slope_sd:.3f}: alpha of a fractional order.",
            soft_wrap=True,
            highlight=False,
        )
    if result.explanations:
        _show_explanations(console, result)
        return
    if result.delay is None or result.delay_sd is None or result.order is None:
        _show_undecided(console, result)
        return
    source = "given" if result.order_given else "found"
    console.print(
        f"The displacement is stamped [bold]{1e3 * result.delay:.2f} ± "
        f"{1e3 * result.delay_sd:.2f} ms[/bold] later than the force; alpha {result.order:.3f} "
        f"± {result.order_sd:.3f} ({source}).",
        soft_wrap=True,
        highlight=False,
    )
    console.print(f"Parameter: displacement.delay: {result.delay:.6f}", highlight=False)


def _show_explanations(console: Any, result: DelayResult) -> None:
    console.print(
        "The phases are not those of a fractional order: the tissue's phase is another one, a "
        "filter is on, or the tool gives way. Such tissue cannot be told from a delay:",
        soft_wrap=True,
    )
    for one in result.explanations:
        console.print(
            f"  {1e3 * one.delay:.2f} ± {1e3 * one.delay_sd:.2f} ms, if {one.words}",
            soft_wrap=True,
            highlight=False,
        )
    console.print("Measure the delay on a spring or a rigid plate instead.", soft_wrap=True)


def _show_undecided(console: Any, result: DelayResult) -> None:
    from fden_ros.report.table import table_of

    console.print(
        "One frequency cannot tell the delay from alpha. Give --alpha, or record a second "
        "frequency. The delay would be:",
        soft_wrap=True,
    )
    longest = max(result.oscillations, key=lambda o: o.end - o.start)
    rows = ((f"{order:g}", f"{1e3 * longest.delay(order):.2f} ms") for order in _ORDERS)
    console.print(table_of({"if alpha is": 0, "delay": 0}, rows))


COMMAND = Command(
    "calibrate",
    "find the delay between force and displacement, or what contacts tell of the rig",
    DESCRIPTION,
    EPILOG,
    parts=(
        Command(
            "delay",
            "delay between the stamps of force and displacement",
            DELAY_DESCRIPTION,
            DELAY_EPILOG,
            add_delay_arguments,
            run,
        ),
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
