# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What stands against a conclusion from a contact, and what would help: a table of words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation import Budget, Estimate, EstimatorConfig, ParameterSet
from fden_ros.core.outputs import WITHHELD, ContactSummary, Flag
from fden_ros.written import quantity, written


class Advice(NamedTuple):
    """What is wrong, and what helps; an empty remedy: nothing is known to."""

    sentence: str
    remedy: str = ""

    def __str__(self) -> str:
        return f"{self.sentence}; {self.remedy}" if self.remedy else self.sentence


#: By the flag of a contact: what counts most comes first.
BY_FLAG: Mapping[Flag, Advice] = {
    Flag.IMPLAUSIBLE: Advice(
        "strain, force, rate or a size cannot be what it says", "check the units"
    ),
    Flag.GEOMETRY_UNSTATED: Advice(
        "the geometry is not stated: the numbers are those of a probe that stands in for it",
        "state probe and tissue (geometry) for G and Gn",
    ),
    Flag.TOUCH_NOT_OBSERVED: Advice(
        "the touch was not observed, in the recording or above noise and drift",
        "begin 1 s in the air, and touch faster or with a larger face, for G and Gn",
    ),
    Flag.ESTIMATION_FAILED: Advice(
        "the computation failed at this site: there is no estimate until the next one",
        "report it, with the traceback of the log",
    ),
    Flag.MODEL_MISMATCH: Advice(
        "the model does not describe this contact: the force is not what it predicts",
        "rely on the measured slope",
    ),
    Flag.TISSUE_CHANGED: Advice(
        "the tissue changed within the contact", "press elsewhere, or less deep"
    ),
    Flag.ALPHA_PRIOR_CONFLICT: Advice(
        "the relaxation contradicts the stated alpha",
        "leave alpha to the data (alpha.learn: true), or state what this tissue has",
    ),
    Flag.RIG_PRIOR_CONFLICT: Advice(
        "friction, delay or compliance is more than 2.5 standard deviations off what is stated, "
        "and the deviations are widened",
        "press a rigid plate, and run fden configure",
    ),
    Flag.FORCE_DRIFTED: Advice(
        "the force in the air after the contact was not that before it, and the deviations are "
        "widened by as much",
        "tare, let the sensor warm up, or state force.drift_sd",
    ),
    Flag.SATURATED: Advice(
        "the force was at its end: stuck, beyond force.limit, or still while the probe went on",
        "press less, or raise force.limit where it is below the sensor's",
    ),
    Flag.GAP: Advice("samples are missing within this site's memory", "make the link reliable"),
}
#: By the source of a variance.
BY_SOURCE: Mapping[str, Advice] = {
    "noise": Advice("noise", "press deeper, or use a larger face or a quieter sensor"),
    "drift": Advice("drift", "state force.drift_sd, or press faster"),
    "friction": Advice("friction", "state force.friction_sd, or press harder"),
    "motion": Advice("motion of the surface", "state surface.motion_sd, or press faster"),
    "compliance": Advice("compliance", "state displacement.compliance_sd"),
    "delay": Advice("delay", "measure it by fden configure"),
    "surface": Advice("the place of the surface", "touch it slower"),
    "law": Advice("errors of the law", "hold for 2 s, and press here again"),
    "thickness": Advice("thickness", "state geometry.thickness_sd"),
    "prior": Advice("what the prior leaves open", "hold for 2 s for alpha, or press deeper"),
}
#: By what a contact lacks without a flag.
BY_LACK: Mapping[str, Advice] = {
    "linear part": Advice(
        "{noise} of noise hide the linear part, so G is not observable",
        "use a larger face or a quieter sensor",
    ),
    "bend": Advice(
        "Gn is not observable: the strain reached {strain:.3f} and did not surely pass the "
        "boundary 1/Gn, about {boundary:.3f}",
        "press to {depth} mm for Gn",
    ),
    "innovation": Advice(
        "not converged: the newest data fail the innovation test", "press here once more"
    ),
    "alpha": Advice("alpha is not determined by the data", "hold for 2 s for alpha"),
    "estimate": Advice("there is no estimate"),
    "end": Advice("the contact was cut short, or data were lost"),
}
#: By the parameter that lies at a limit of its prior.
BY_LIMIT: Mapping[ParameterSet, Advice] = {
    ParameterSet.LINEAR_STIFFNESS: Advice(
        "G lies at a limit of its prior", "check units and geometry, or leave prior.* out"
    ),
    ParameterSet.NONLINEAR_STIFFNESS: Advice(
        "Gn lies at a limit of its prior",
        "leave prior.* out, or state prior.nonlinear_stiffness_log_sd as 1",
    ),
    ParameterSet.FRACTIONAL_ORDER: Advice(
        "alpha lies at a limit of what tissue has",
        "measure the delay by fden configure, or rely on the measured slope",
    ),
}
#: Gn shows where the strain passes 1/Gn; at this many times of it, it surely has.
_BEYOND_BOUNDARY = 1.5
#: No soft tissue is pressed farther, as a part of its thickness or of the probe's radius.
_LARGEST_COMPRESSION = 0.7
#: Sources of a variance that are named at most.
_NAMED = 4


def shortfall(summary: ContactSummary, config: PipelineConfig) -> str:
    """Return what a contact that has not converged lacks, why, and what would help.

    Empty where it has converged, or where a flag or the end of a range says why.
    """
    found = _lack(summary, config)
    return str(found) if found is not None else ""


def next_step(summary: ContactSummary, config: PipelineConfig) -> str:
    """Return what to do so that more of a place is known; empty where all is."""
    remedies = (one.remedy for one in findings(summary, config))
    return next(filter(None, remedies), "")


def against_the_law(summary: ContactSummary) -> str:
    """Return in one line what stands against G and Gn of a contact that lacks nothing else."""
    found = [*_at_limit(summary.estimate), *_by_flag(summary)]
    return found[0].sentence if found else "the data do not determine them"


def remarks(summary: ContactSummary, config: PipelineConfig) -> Iterator[str]:
    """Yield a sentence for each of :func:`findings`."""
    for one in map(str, findings(summary, config)):
        yield f"{one[0].upper()}{one[1:]}."


def findings(summary: ContactSummary, config: PipelineConfig) -> Iterator[Advice]:
    """Yield what stands against a conclusion, what counts most first."""
    estimate = summary.estimate
    yield from _by_flag(summary)
    lack = _lack(summary, config)
    if lack is not None and lack not in BY_FLAG.values():
        yield lack
    yield from _at_limit(estimate)
    if estimate is None:
        yield BY_LACK["estimate"]
    elif not (estimate.at_edge or estimate.determines(2)):
        yield BY_LACK["alpha"]
    if not summary.complete:
        yield BY_LACK["end"]
    if summary.rejected_count:
        yield Advice(f"{summary.rejected_count} samples were rejected during the contact")


def _by_flag(summary: ContactSummary) -> Iterator[Advice]:
    for flag, advice in BY_FLAG.items():
        if summary.flags & flag and not (flag == Flag.TOUCH_NOT_OBSERVED and summary.is_of_path):
            yield advice


def _at_limit(estimate: Estimate | None) -> Iterator[Advice]:
    if estimate is not None:
        yield from (advice for one, advice in BY_LIMIT.items() if one in estimate.at_edge)


def _lack(summary: ContactSummary, config: PipelineConfig) -> Advice | None:
    estimate, budget = summary.estimate, summary.budget
    if summary.flags & Flag.TOUCH_NOT_OBSERVED and not summary.is_of_path:
        return BY_FLAG[Flag.TOUCH_NOT_OBSERVED]
    is_closed = summary.converged or estimate is None or bool(estimate.at_edge)
    if estimate is None or is_closed or summary.flags & WITHHELD:
        return None
    hidden = budget is not None and estimate.boundary_stress < budget.stress_noise
    if budget is not None and hidden and not estimate.knows(0):
        noise = quantity(budget.stress_noise / config.geometry.stress_per_force, "N")
        sentence, mend = BY_LACK["linear part"]
        return Advice(sentence.format(noise=noise), mend)
    if not estimate.determines(1):
        return _bend(summary, estimate, config)
    poor = _poor(estimate, config.estimator)
    if not poor:
        return BY_LACK["innovation"]
    known = ", ".join(
        f"{name} is known to {_percent(float(estimate.deviations[k]))}" for k, name in poor
    )
    named = budget.largest(poor[0][0])[:_NAMED] if budget is not None else ()
    # What is open of Gn and alpha is so because of the others.
    source = next((name for name in named if name != "prior"), "prior")
    return Advice(f"{known} only{_shares(budget, poor[0][0])}", BY_SOURCE[source].remedy)


def _bend(summary: ContactSummary, estimate: Estimate, config: PipelineConfig) -> Advice:
    """Return what a press lacks that hardly stiffened."""
    geometry, (sentence, remedy) = config.geometry, BY_LACK["bend"]
    wanted = _BEYOND_BOUNDARY * max(1.0 / estimate.nonlinear_stiffness, summary.max_strain)
    compression = geometry.compression(wanted)
    depth = written(1e3 * geometry.length * compression, 2)
    mend = remedy.format(depth=depth) if compression < _LARGEST_COMPRESSION else ""
    said = sentence.format(strain=summary.max_strain, boundary=estimate.boundary_strain)
    said += _shares(summary.budget, 1)
    return Advice(f"G is known, {said}" if estimate.knows(0) else said, mend)


def _poor(estimate: Estimate, config: EstimatorConfig) -> list[tuple[int, str]]:
    """Return place and name of what is not known closely enough: G before Gn."""
    limits = (config.converged_log_g_sd, config.converged_log_gn_sd)
    names = ("G", "Gn")
    return [(k, names[k]) for k in (0, 1) if estimate.deviations[k] > limits[k]]


def _shares(budget: Budget | None, index: int) -> str:
    """Return what the variance of ln G or ln Gn is made of, the largest first."""
    if budget is None:
        return ""
    parts = [
        f"{BY_SOURCE[name].sentence} {100.0 * budget.share(name, index):.0f} %"
        for name in budget.largest(index)[:_NAMED]
    ]
    return f" (of the variance: {', '.join(parts)})" if parts else ""


def _percent(sd: float) -> str:
    """Return the deviation of a logarithm, as a factor where it is as large as the number."""
    if sd < 1.0:
        return f"{100.0 * sd:.0f} %"
    return f"a factor of {written(math.exp(min(sd, 20.0)), 2)}"
