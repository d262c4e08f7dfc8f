# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden train``: a tissue library from labelled contacts."""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fden_ros.commands.command import add_json, number, print_json, write
from fden_ros.commands.inputs import add_input_options, parameters_of, selection_of
from fden_ros.errors import InputError
from fden_ros.written import written

if TYPE_CHECKING:
    from fden_ros.core.classification import TissueLibrary
    from fden_ros.offline.labelled import Source
    from fden_ros.parameters import Parameters
    from fden_ros.tissues.training import Check, Contacts, Spread

DESCRIPTION = """\
Learn a tissue library from labelled contacts: per tissue the distribution of (ln G, ln Gn, alpha)
over specimens, without the estimation error of each contact. A check leaves one specimen out at a
time. LABELLED is

  TISSUE=BAG             a bag, a folder of bags or a table of samples, all of this tissue
  TISSUE/SPECIMEN=BAG    and all of this specimen
"""

EPILOG = """\
examples:
  fden train liver/pig1=bags/pig1 liver/pig2=bags/pig2 muscle/pig1=bags/muscle1 \\
      --config probe.yaml -o library.yaml --prior liver=0.8 --prior muscle=0.15
then: fden replay BAG --config probe.yaml, with classifier.library: library.yaml in it

The prior of the estimator is in every estimate, and is taken out again: make that of --config
wide. Contacts that have not converged are left out.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    parser.add_argument("labelled", nargs="+", metavar="LABELLED", help="as above")
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE", help="the library, YAML"
    )
    parser.add_argument("--name", help="name of the library (default: that of the file)")
    parser.add_argument(
        "--prior",
        type=_prior,
        action="append",
        default=[],
        metavar="TISSUE=P",
        help="probability of meeting a tissue, up to a common factor (default: all alike)",
    )
    parser.add_argument(
        "--unknown",
        type=number(above=0.0, below=1.0),
        default=None,
        metavar="P",
        help="probability of meeting what is none of them (default: 0.1)",
    )
    add_json(parser)
    add_input_options(parser)


def run(args: argparse.Namespace) -> int:
    """Learn, check, write and print; return the exit code."""
    from fden_ros.progress import progress
    from fden_ros.tissues.library import units_of
    from fden_ros.tissues.training import (
        UNKNOWN_PRIOR,
        check,
        check_object,
        learn,
        library_of,
        library_text,
    )

    parameters = parameters_of(args)
    contacts, unlearned = _read(args, parameters)
    probe = parameters.geometry.build()
    geometry = _geometry(parameters) if probe.is_stated else {}
    units = units_of(probe)
    unknown = UNKNOWN_PRIOR if args.unknown is None else args.unknown
    name, kind = args.name or args.output.stem, str(geometry.get("kind", ""))

    def make(spreads: Mapping[str, Spread]) -> TissueLibrary:
        return library_of(spreads, name, dict(args.prior), unknown, units, kind)

    spreads = learn(contacts)
    with progress("one specimen left out", len(set(contacts.groups))) as show:
        result = check(contacts, spreads, make, show)
    text = library_text(make(spreads), spreads, contacts, result, geometry)
    write(args.output, lambda path: path.write_text(text, encoding="utf-8"))
    if args.json:
        return print_json(
            {
                "library": str(args.output),
                "units": units,
                "contacts": len(contacts),
                "mismatched": contacts.mismatched,
                "left_out": dict(contacts.skipped),
                "check": check_object(result),
                "warnings": [*unlearned, *_warnings(contacts, result)],
            }
        )
    _print(contacts, spreads, result, units, [*unlearned, *_warnings(contacts, result)])
    print(f"wrote {args.output}")
    return 0


def _read(args: argparse.Namespace, parameters: Parameters) -> tuple[Contacts, list[str]]:
    """Return the contacts, and of each tissue that has none of use why, in a line."""
    from fden_ros.offline.labelled import Source, read_source
    from fden_ros.progress import progress
    from fden_ros.tissues.training import joined

    selection = selection_of(args)
    sources = [Source.parse(text) for text in args.labelled]
    parts = []
    with progress("contacts", len(sources)) as show:
        for source in sources:
            parts.append(read_source(source, parameters, selection))
            show(len(parts))
    unlearned = _unlearned(sources, parts)
    if not any(map(len, parts)):
        raise InputError("; ".join(unlearned.values()))
    contacts = joined(parts)
    for tissue, _ in args.prior:
        if tissue in unlearned:
            raise InputError(f"--prior {tissue}: {unlearned[tissue]}")
        if tissue not in contacts.classes:
            raise InputError(
                f"--prior {tissue}: there is no such tissue in the data; it has "
                f"{', '.join(contacts.classes)}"
            )
    return contacts, list(unlearned.values())


def _unlearned(sources: Sequence[Source], parts: Sequence[Contacts]) -> dict[str, str]:
    """Return why tissues cannot be learned, by their names."""
    lines = {}
    for tissue in dict.fromkeys(source.tissue for source in sources):
        own = [(s, part) for s, part in zip(sources, parts, strict=True) if s.tissue == tissue]
        if any(len(part) for _, part in own):
            continue
        left_out = sum((Counter(part.skipped) for _, part in own), Counter[str]())
        why = ", ".join(f"{count} {reason}" for reason, count in left_out.items())
        places = " ".join(str(source.path) for source, _ in own)
        lines[tissue] = (
            f"{tissue} cannot be learned: none of its contacts has converged "
            f"({why or 'no contact was found'}); fden replay says of {places} what they lack"
        )
    return lines


def _geometry(parameters: Parameters) -> dict[str, Any]:
    geometry = parameters.geometry
    sizes = geometry.build().sizes
    return {"kind": geometry.kind} | {name: getattr(geometry, name) for name in sizes}


def _warnings(contacts: Contacts, result: Check) -> list[str]:
    warnings = []
    if contacts.unnamed:
        warnings.append(
            f"no specimen is named for {', '.join(contacts.unnamed)}: each contact counts as a "
            "specimen of its own, so spread and check are too good where contacts share one"
        )
    for name in result.unchecked:
        warnings.append(
            f"{name} has a single specimen: its spread is that of the others, and leaving it out "
            "would leave none, so it is not checked"
        )
    if contacts.mismatched:
        warnings.append(
            f"{contacts.mismatched} of {len(contacts)} contacts are not described by the model "
            "(model_mismatch): their deviations hold the law's error only where "
            "model_discrepancy.sd is not 0, and what differs may be the material"
        )
    for reason, count in contacts.skipped.items():
        warnings.append(f"left out: {count} {reason}")
    return warnings


def _print(
    contacts: Contacts,
    spreads: Mapping[str, Spread],
    result: Check,
    units: str,
    warnings: Sequence[str],
) -> None:
    import numpy as np
    from rich.console import Console
    from rich.markup import escape

    from fden_ros.report.table import table_of

    console = Console()
    if not console.is_terminal:
        console.width = 120
    rows = []
    for name, spread in spreads.items():
        tissue = spread.tissue(name)
        sd = np.sqrt(np.diag(tissue.covariance))
        rows.append(
            (
                escape(name),
                str(spread.contacts),
                "not named" if name in contacts.unnamed else str(spread.specimens),
                written(math.exp(tissue.mean[0]), 4),
                f"{np.exp(sd[0]):.2f}",
                written(math.exp(tissue.mean[1]), 3),
                f"{np.exp(sd[1]):.2f}",
                f"{tissue.mean[2]:.3f}",
                f"{sd[2]:.3f}",
            )
        )
    numbers = (
        "contacts",
        "specimens",
        f"G [{units} s^α]",
        "G × or ÷",
        "Gn",
        "Gn × or ÷",
        "α",
        "α ±",
    )
    columns = {"tissue": 1, **dict.fromkeys(numbers, 0)}
    console.print(table_of(columns, rows, "Tissues: median and spread over contacts"))
    if len(result.truth):
        answers = (
            (escape(name), *map(str, row))
            for name, row in zip(result.names[:-1], result.confusion(), strict=True)
            if row.sum()
        )
        title = "Check, one specimen left out: truth (row) and most probable answer"
        console.print(table_of({"": 1, **dict.fromkeys(result.names, 0)}, answers, title))
        low, high = result.interval()
        console.print(
            f"error {np.mean(result.errors):.1%} (95 %: {low:.1%} to {high:.1%}) over "
            f"{len(result.truth)} contacts of {len(set(result.groups))} specimens"
        )
    for warning in warnings:
        console.print(f"[yellow]note:[/yellow] {escape(warning)}", soft_wrap=True)


def _prior(text: str) -> tuple[str, float]:
    name, _, number = text.rpartition("=")
    try:
        value = float(number)
    except ValueError:
        value = 0.0
    if not name or not value > 0.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not TISSUE=P with a positive P")
    return name, value
