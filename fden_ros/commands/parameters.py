# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden parameters``: every parameter of the identifier, as a parameter file."""

from __future__ import annotations

import argparse
import textwrap

from fden_ros.parameters import PARAMETERS, Value

DESCRIPTION = """\
Print a parameter file with every parameter of the identifier at its default,
each explained. Keep the values that differ for your probe, and pass the file
to the node (--params-file) or to `fden replay --config`.
"""

EPILOG = """\
examples:
  fden parameters > probe.yaml
"""

_HEADER = """\
# Parameters of the identifier, all at their defaults. Keep what differs for your probe.
/**:
  ros__parameters:
"""


def run(args: argparse.Namespace) -> int:
    """Print the parameters; return the exit code."""
    print(parameter_file(), end="")
    return 0


def parameter_file() -> str:
    """Return a commented parameter file with every parameter at its default."""
    lines: list[str] = []
    group = ""
    for parameter in PARAMETERS:
        head, _, name = parameter.name.partition(".")
        if head != group:
            lines.append(f"    {head}:")
            group = head
        comment = f"{parameter.description} [{parameter.unit}]"
        if parameter.constraint:
            comment += f" Allowed: {parameter.constraint}."
        lines += textwrap.wrap(
            comment, 95, initial_indent="      # ", subsequent_indent="      # "
        )
        lines.append(f"      {name}: {_yaml(parameter.default)}")
    return _HEADER + "\n".join(lines) + "\n"


def _yaml(value: Value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    # YAML 1.1 takes 1e-05 for a text.
    return f"{value:.1e}" if isinstance(value, float) and 0 < value < 1e-3 else str(value)
