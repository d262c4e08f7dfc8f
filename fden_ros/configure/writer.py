# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The commented parameter file of a survey: values, deviations, sources, and what is missing."""

from __future__ import annotations

import shlex
import textwrap
from collections.abc import Sequence

import yaml

from fden_ros.configure.finding import SUBJECTS, Finding
from fden_ros.configure.reading import MESSAGES, Reading
from fden_ros.configure.survey import Survey
from fden_ros.parameters import ATTENTION_LINE, LIVE_LINE, OPEN_AXIS, PARAMETERS, Value
from fden_ros.recording.source import SELECTION_LINE

#: Readable units of values.
_SCALES = {"s": (1e3, "ms"), "m": (1e3, "mm"), "m/N": (1e3, "mm/N"), "rad": (1.0, "")}


def parameter_values(survey: Survey, readings: Sequence[Reading]) -> dict[str, Value]:
    """Return the proposed parameters, by dotted name, in the order of the table."""
    first = readings[0]
    values: dict[str, Value] = {
        f"{stream}.message": MESSAGES.get(type_name, "")
        for stream, type_name in first.types.items()
    }
    values |= {f"{stream}.name": joint for stream, joint in first.joints.items()}
    if first.selection.stamps != "header":
        values["synchronize.stamp_source"] = "receive"
    for finding in survey.findings:
        values |= finding.parameters
    return {
        parameter.name: values[parameter.name]
        for parameter in PARAMETERS
        if parameter.name in values
        and (not parameter.choices or values[parameter.name] in parameter.choices)
    }


def replay_problems(survey: Survey) -> list[str]:
    """Return why `fden replay` with the file will not give reliable numbers, a line each."""
    problems = []
    unknown: dict[str, list[str]] = {}
    for stream in ("force", "displacement"):
        unit, axis = survey.finding(f"{stream} unit"), survey.finding(f"{stream} axis")
        if not unit.claim:
            problems.append(f"{unit.subject}: {unit.evidence}; {unit.motion}")
        if not axis.claim:
            unknown.setdefault(f"{axis.evidence}. To find out: {axis.motion}", []).append(stream)
    for why, names in unknown.items():
        problems.append(f"{OPEN_AXIS}{' and of the '.join(names)} is not known: {why}")
    lift_off = survey.finding("lift-off")
    if lift_off.value == "never":
        problems.append(f"no touch is certain: {lift_off.motion}")
    if not survey.finding("indenter").claim:
        problems.append(
            "the indenter is the default, a flat face of 1 cm^2 on 20 mm, so G and Gn are "
            "wrong: state yours (--flat-punch AREA or --sphere R, with --thickness H)"
        )
    return problems


def parameter_file(survey: Survey, readings: Sequence[Reading], notes: Sequence[str] = ()) -> str:
    """Return the commented parameter file, with notes at its head."""
    values = parameter_values(survey, readings)
    lines = _head(survey, readings, notes)
    lines += ["/**:", "  ros__parameters:" + ("" if values else " {}")]
    for group in dict.fromkeys(parameter.name.partition(".")[0] for parameter in PARAMETERS):
        for finding in survey.findings:
            if SUBJECTS[finding.subject].group == group:
                lines += _comment(_sentence(finding), "    ")
        inside = {name: value for name, value in values.items() if name.startswith(f"{group}.")}
        lines += [f"    {group}:"] if inside else []
        lines += [f"      {name.partition('.')[2]}: {_yaml(v)}" for name, v in inside.items()]
    return "\n".join(lines) + "\n"


def value_text(finding: Finding) -> str:
    """Return value and deviation in words."""
    value, sd = finding.value, finding.deviation
    if value is None or isinstance(value, str):
        return value or "-"
    if finding.subject.endswith("axis"):
        if isinstance(value, float):
            return "grows" if value > 0.0 else "falls"
        return "[" + ", ".join(f"{part:.4f}" for part in value) + "]"
    assert isinstance(value, float)
    scale, unit = _SCALES.get(finding.unit, (1.0, finding.unit))
    digits = max(2, min(6, len(str(int(abs(value / sd)))) + 2)) if sd and value else 4
    text = f"{scale * value:.{digits}g}"
    if sd and sd >= 1e-6 * abs(value):
        text += f" ± {scale * sd:.2g}"
    return f"{text} {unit}".strip()


def _sentence(finding: Finding) -> str:
    """Return the whole text of a finding."""
    if finding.claim:
        return f"{finding.subject}: {value_text(finding)}; {finding.evidence}."
    known = f" {value_text(finding)};" if finding.value is not None else ""
    why = f"NOT FOUND;{known} {finding.evidence}"
    return f"{finding.subject}: {why}. To find out: {finding.motion}."


def _head(survey: Survey, readings: Sequence[Reading], notes: Sequence[str]) -> list[str]:
    first, lines = readings[0], ["# Proposed by fden configure from"]
    for reading in readings:
        force, displacement = (_source(reading, stream) for stream in ("force", "displacement"))
        lines += _comment(f"{reading.path}: force {force}, displacement {displacement}")
        for warning in reading.warnings:
            lines += _comment(f"warning: {warning}")
    if first.types:
        names = {stream: first.inputs[stream].partition(" ")[0] for stream in first.types}
        remaps = " ".join(f"-r {stream}:={name}" for stream, name in names.items())
        lines.append(f"{LIVE_LINE}{remaps}")
    if chosen := first.selection.options():
        lines.append(f"{SELECTION_LINE}{shlex.join(chosen)}")
    lines.append("# ± is one standard deviation. Parameters at their defaults are left out.")
    for problem in replay_problems(survey):
        lines += _comment(f"{ATTENTION_LINE.removeprefix('# ')}{problem}")
    for note in notes:
        lines += _comment(f"note: {note}")
    lines.append("#")
    for finding in survey.findings:
        if not SUBJECTS[finding.subject].group:
            lines += _comment(_sentence(finding))
    return lines


def _source(reading: Reading, stream: str) -> str:
    words = [reading.types.get(stream, "").replace("/msg/", "/")]
    words += [f"joint {reading.joints[stream]}"] if stream in reading.joints else []
    return f"{reading.inputs[stream]} ({', '.join(words)})" if words[0] else reading.inputs[stream]


def _comment(text: str, indent: str = "") -> list[str]:
    wrapper = textwrap.TextWrapper(95, f"{indent}# ", f"{indent}#   ")
    wrapper.break_long_words = wrapper.break_on_hyphens = False
    return wrapper.wrap(text)


def _yaml(value: Value) -> str:
    """Return a value in one line; floats keep a point, as ROS 2 wants them."""
    if isinstance(value, list):
        value = [float(f"{part:.6g}") for part in value]
    return yaml.safe_dump(value, default_flow_style=True, width=1000).splitlines()[0]
