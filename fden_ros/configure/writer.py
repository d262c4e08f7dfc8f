# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The parameter file of a survey, commented: value, deviation, where from, and what is missing."""

from __future__ import annotations

import shlex
import textwrap
from collections.abc import Sequence

from fden_ros.configure.finding import Finding
from fden_ros.configure.reading import MESSAGES, Reading
from fden_ros.configure.survey import Survey
from fden_ros.errors import InputError
from fden_ros.parameters import PARAMETERS, Value
from fden_ros.recording.source import SELECTION_LINE
from fden_ros.recording.table import stated_columns

_WIDTH = 95
#: Group of the parameter file in which a finding without parameters is told.
_GROUPS = {
    "force axis": "force",
    "displacement axis": "displacement",
    "delay": "displacement",
    "compliance": "displacement",
    "tool mass": "tool",
    "tool centre of mass": "tool",
    "surface normal": "surface",
    "indenter": "geometry",
    "prior": "prior",
}


def parameter_values(survey: Survey, readings: Sequence[Reading]) -> dict[str, Value]:
    """Return the proposed parameters, by dotted name."""
    values: dict[str, Value] = {}
    for reading in readings[:1]:
        for what, type_name in reading.types.items():
            if type_name in MESSAGES and _has(f"{what}.message", MESSAGES[type_name]):
                values[f"{what}.message"] = MESSAGES[type_name]
        for what, joint in reading.joints.items():
            values[f"{what}.name"] = joint
    for finding in survey.findings:
        values.update(finding.parameters)
    return values


def replay_problems(survey: Survey, readings: Sequence[Reading]) -> list[str]:
    """Return why `fden replay` with the file will not give numbers to rely on, a line each."""
    problems = []
    unknown: dict[str, list[str]] = {}
    for what in ("force", "displacement"):
        unit, axis = survey.finding(f"{what} unit"), survey.finding(f"{what} axis")
        if not unit.claim:
            problems.append(f"{unit.subject}: {unit.evidence}; {unit.motion}")
        elif unit.value in ("mm", "g"):
            problems.append(f"{what}: {unit.evidence.partition(': ')[2]}")
        if not axis.claim:
            unknown.setdefault(f"{axis.evidence}. To find out: {axis.motion}", []).append(what)
    for why, names in unknown.items():
        problems.append(f"the axis of the {' and of the '.join(names)} is not known: {why}")
    if survey.finding("lift-off").value == "never":
        problems.append("no touch is seen for sure: begin with 2 s in the air, 3 mm off")
    if not survey.finding("indenter").claim:
        problems.append(
            "the indenter is the default's, a flat face of 1 cm^2 on 20 mm: G and Gn are not the "
            "tissue's before you state yours (--flat-punch AREA --thickness H, --sphere R)"
        )
    return problems


def replay_command(path: str, reading: Reading) -> str:
    """Return the command that replays a recording with the file at `path`."""
    return f"fden replay {shlex.quote(str(reading.path))} --config {shlex.quote(path)}"


def _chosen(reading: Reading) -> list[str]:
    """Return the options that say what in a recording was read, where they are needed."""
    parts = []
    chosen = reading.selection
    for what in ("force", "displacement"):
        for part in ("topic", "field"):
            value = getattr(chosen, f"{what}_{part}")
            parts += [f"--{what}-{part}", value] if value else []
    if chosen.columns is not None and not _says_itself(reading):
        of = [chosen.columns.time, chosen.columns.force, chosen.columns.displacement]
        text = ",".join(c.name if c.factor == 1 else f"{c.name}*{c.factor}" for c in of)
        parts += ["--columns", text]
    if chosen.where is not None:
        parts += ["--rows", f"{chosen.where[0]}={chosen.where[1]}"]
    return parts


def _says_itself(reading: Reading) -> bool:
    """Whether the headings of a table say the columns that were read."""
    try:
        return stated_columns(reading.path) == reading.selection.columns
    except InputError:
        return False


def parameter_file(survey: Survey, readings: Sequence[Reading], notes: Sequence[str] = ()) -> str:
    """Return the commented parameter file, with notes at its head."""
    values = parameter_values(survey, readings)
    owners = {name: finding for finding in survey.findings for name in finding.parameters}
    lines = _head(survey, readings)
    for note in notes:
        lines += _comment(f"note: {note}", "")
    lines += ["/**:", "  ros__parameters:" + ("" if values else " {}")]
    groups = dict.fromkeys(parameter.name.partition(".")[0] for parameter in PARAMETERS)
    for group in groups:
        inside = [name for name in _ordered(values) if name.partition(".")[0] == group]
        missing = [
            finding
            for finding in survey.findings
            if _GROUPS.get(finding.subject) == group and not finding.parameters
        ]
        for finding in missing:
            lines += _comment(_sentence(finding), "    ")
        if not inside:
            continue
        lines.append(f"    {group}:")
        told: list[str] = []
        for name in inside:
            owner = owners.get(name)
            if owner is not None and owner.subject not in told:
                lines += _comment(_sentence(owner), "      ")
                told.append(owner.subject)
            lines.append(f"      {name.partition('.')[2]}: {_yaml(values[name])}")
    return "\n".join(lines) + "\n"


def value_text(finding: Finding) -> str:
    """Return value and deviation in words."""
    value, sd = finding.value, finding.deviation
    if value is None:
        return "-"
    if isinstance(value, str):
        return value
    if finding.subject.endswith(("axis", "normal")):
        if isinstance(value, float):
            return "grows" if value > 0.0 else "falls"
        return "[" + ", ".join(f"{part:.4f}" for part in value) + "]"
    if finding.subject == "prior" and isinstance(value, tuple):
        return "G {:.3g} Pa s^alpha, Gn {:.3g}, alpha {:.2g}".format(*value)
    scale, unit = _SCALES.get(finding.unit, (1.0, finding.unit))
    if isinstance(value, tuple):
        text = "[" + ", ".join(f"{scale * part:.4g}" for part in value) + "]"
    else:
        digits = 4 if not sd or not value else max(2, min(6, _digits(value / sd) + 1))
        text = f"{scale * value:.{digits}g}"
    if sd and not (isinstance(value, float) and sd < 1e-6 * abs(value)):
        text += f" ± {scale * sd:.2g}"
    return f"{text} {unit}".strip()


#: Units in which a person reads the values.
_SCALES = {"s": (1e3, "ms"), "m": (1e3, "mm"), "m/N": (1e3, "mm/N"), "rad": (1.0, "")}


def _digits(ratio: float) -> int:
    return len(str(int(abs(ratio)))) + 1


def seconds_text(finding: Finding) -> str:
    """Return the seconds that a finding rests on, the first three stretches."""
    if not finding.seconds:
        return ""
    shown = ", ".join(f"{a:.1f} to {b:.1f}" for a, b in finding.seconds[:3])
    more = len(finding.seconds) - 3
    return f"{shown} s" + (f" and {more} more" if more > 0 else "")


def _sentence(finding: Finding) -> str:
    seconds = seconds_text(finding)
    where = f" (seconds {seconds.removesuffix(' s')})" if seconds else ""
    if finding.claim:
        return f"{finding.subject}: {value_text(finding)}; {finding.evidence}{where}."
    known = f" {value_text(finding)};" if finding.value is not None else ""
    return (
        f"{finding.subject}: CANNOT TELL;{known} {finding.evidence}{where}. To find out: "
        f"{finding.motion}."
    )


def _head(survey: Survey, readings: Sequence[Reading]) -> list[str]:
    lines = ["# Proposed by fden configure from"]
    for reading in readings:
        lines += _comment(
            f"{reading.path}: force {_source(reading, 'force')}, displacement "
            f"{_source(reading, 'displacement')}",
            "",
        )
        for warning in reading.warnings:
            lines += _comment(f"warning: {warning}", "")
    first = readings[0]
    if first.types:
        names = {what: first.inputs[what].partition(" ")[0] for what in first.inputs}
        lines.append(
            f"# Live: -r force:={names['force']} -r displacement:={names['displacement']}"
        )
    if chosen := _chosen(first):
        lines.append(f"{SELECTION_LINE}{shlex.join(chosen)}")
    lines.append("# ± is one standard deviation. What stays at its default is left out.")
    for problem in replay_problems(survey, readings):
        lines += _comment(f"ATTENTION: {problem}", "")
    lines.append("#")
    for finding in survey.findings:
        if finding.subject not in _GROUPS:
            lines += _comment(_sentence(finding), "")
    return lines


def _source(reading: Reading, what: str) -> str:
    parts = [reading.inputs[what]]
    if what in reading.types:
        parts.append(reading.types[what].replace("/msg/", "/"))
    if what in reading.joints:
        parts.append(f"joint {reading.joints[what]}")
    if reading.frames.get(what):
        parts.append(f"frame {reading.frames[what]}")
    return f"{parts[0]} ({', '.join(parts[1:])})" if len(parts) > 1 else parts[0]


def _has(name: str, value: str) -> bool:
    return any(p.name == name and value in p.choices for p in PARAMETERS)


def _ordered(values: dict[str, Value]) -> list[str]:
    return [parameter.name for parameter in PARAMETERS if parameter.name in values]


def _comment(text: str, indent: str) -> list[str]:
    return textwrap.wrap(
        text,
        _WIDTH,
        initial_indent=f"{indent}# ",
        subsequent_indent=f"{indent}#   ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def _yaml(value: Value) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, list):
        return "[" + ", ".join(_yaml(float(part)) for part in value) + "]"
    if isinstance(value, float):
        text = f"{value:.6g}"
        mantissa, exponent, power = text.partition("e")
        # ROS 2 reads a number without a point as a whole one.
        return (mantissa if "." in mantissa else mantissa + ".0") + exponent + power
    return str(value)
