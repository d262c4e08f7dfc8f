# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden train``: a tissue library from tables of contacts."""

from __future__ import annotations

import argparse

from fden_ros.commands.command import write
from fden_ros.commands.inputs import parameters_of
from fden_ros.errors import InputError

DESCRIPTION = """\
Learn a tissue library: mean and covariance of (ln G, ln Gn, alpha) of each
class, without the stated error of each contact. TISSUE=TABLE names a table of
fden batch (CSV) whose contacts are all on this tissue. Contacts that have not
converged are left out.
"""

EPILOG = """\
examples:
  fden batch bags/liver --config probe.yaml -o liver.csv
  fden batch bags/muscle --config probe.yaml -o muscle.csv
  fden train liver=liver.csv muscle=muscle.csv --config probe.yaml -o library.yaml
Then state the library in probe.yaml: classifier: {library: library.yaml}

Every estimate contains the estimator's prior, so make the prior of --config
wide.
"""


def run(args: argparse.Namespace) -> int:
    """Learn, write and print; return the exit code."""
    import numpy as np
    from rich.console import Console

    from fden_ros.report.table import table_of
    from fden_ros.tissues.library import parse_library, units_of
    from fden_ros.tissues.training import library_of, library_text, read_contacts

    geometry = parameters_of(args).geometry
    probe = geometry.build()
    classes = {name: read_contacts(path) for name, path in map(_label, args.labelled)}
    library = library_of(classes, args.output.stem, units_of(probe), probe.kind)
    sizes = {name: getattr(geometry, name) for name in probe.sizes}
    text = library_text(library, {"kind": geometry.kind, **sizes} if probe.is_stated else {})
    parse_library(text, "the learned library")
    write(args.output, lambda path: path.write_text(text, encoding="utf-8"))
    rows = []
    for tissue in library.tissues:
        sd = np.sqrt(np.diag(tissue.covariance))
        medians = (*np.exp(tissue.mean[:2]), tissue.mean[2])
        numbers = (number for pair in zip(medians, sd, strict=True) for number in pair)
        count = str(len(classes[tissue.name].mean))
        rows.append((tissue.name, count, *(f"{number:.3g}" for number in numbers)))
    names = ("contacts", f"G [{library.units} s^α]", "sd(ln G)", "Gn", "sd(ln Gn)", "α", "sd(α)")
    Console().print(table_of({"tissue": 1, **dict.fromkeys(names, 0)}, rows))
    print(f"wrote {args.output}")
    return 0


def _label(text: str) -> tuple[str, str]:
    name, separator, path = text.partition("=")
    if not name or not separator:
        raise InputError(f"{text}: which tissue is it? Write TISSUE={text}")
    return name, path
