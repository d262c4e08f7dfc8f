# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Doubts about the result of a contact, and their remedies."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from fden_ros.advice import FLAGS, LACKS, SOURCES, Advice
from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation import Budget, Estimate, EstimatorKind
from fden_ros.core.outputs import WITHHELD, ContactSummary, Flag
from fden_ros.written import quantity, written

#: Gn shows where the strain exceeds 1/Gn; at this multiple it surely has.
_BEYOND_BOUNDARY = 1.5
#: Largest strain of soft tissue in practice, as a part of its thickness or the probe's radius.
_LARGEST_COMPRESSION = 0.7
#: A source of variance is named beside the largest above this part of it [1].
_NEAR = 0.75
#: Flags that explain what a contact lacks, whatever its budget.
_REASONS = (
    Flag.TOUCH_NOT_OBSERVED,
    Flag.SATURATED,
    Flag.TISSUE_CHANGED,
    Flag.MODEL_MISMATCH,
    Flag.RIG_PRIOR_CONFLICT,
)


def shortfall(summary: ContactSummary, config: PipelineConfig) -> str:
    """Return what a contact lacks, N/m or more, with cause and remedy, or nothing."""
    return str(_lack(summary, config) or "")


def next_step(summary: ContactSummary, config: PipelineConfig) -> str:
    """Return what to do to learn more about a place; empty if everything is known."""
    return next((one.remedy for one in findings(summary, config) if one.remedy), "")


def against_the_law(summary: ContactSummary) -> str:
    """Return in one line why G and Gn of a contact that lacks nothing else are in doubt."""
    found = [*_at_limit(summary.estimate), *_by_flag(summary)]
    return found[0].sentence if found else "the data do not determine them"


def findings(summary: ContactSummary, config: PipelineConfig) -> Iterator[Advice]:
    """Yield the doubts about a conclusion, the most important first."""
    estimate, lack = summary.estimate, _lack(summary, config)
    yield from _by_flag(summary)
    if lack is not None and lack not in FLAGS.values():
        yield lack
    yield from _at_limit(estimate)
    if estimate is None:
        yield LACKS["estimate"]
    elif not (estimate.at_edge or estimate.determines(2)):
        yield LACKS["alpha"]
    if not summary.complete:
        yield LACKS["end"]
    if summary.rejected_count:
        yield LACKS["rejected"].of(count=summary.rejected_count)


def _by_flag(summary: ContactSummary) -> Iterator[Advice]:
    hidden = Flag.TOUCH_NOT_OBSERVED if summary.is_of_path else Flag.NONE
    yield from (FLAGS[name] for name in FLAGS if summary.flags & ~hidden & Flag[name])


def _at_limit(estimate: Estimate | None) -> Iterator[Advice]:
    yield from (LACKS[name] for name in (estimate.at_edge.names if estimate else ()))


def _lack(summary: ContactSummary, config: PipelineConfig) -> Advice | None:
    estimate, budget = summary.estimate, summary.budget
    if summary.converged and Flag.MODEL_MISMATCH not in summary.flags:
        return None
    reason = next((flag.name for flag in _REASONS if flag & summary.flags), None)
    if reason is not None and not summary.is_of_path:
        return FLAGS[reason]
    if estimate is None or estimate.at_edge or summary.flags & WITHHELD:
        return None
    noise = budget.stress_noise if budget is not None else 0.0
    if estimate.boundary_stress < noise and not estimate.knows(0):
        force = quantity(noise / config.geometry.stress_per_force, "N")
        return LACKS["linear part"].of(noise=force)
    if not estimate.determines(1):
        return _bend(summary, estimate, config)
    limits = config.estimator.converged_log_g_sd, config.estimator.converged_log_gn_sd
    poor = [k for k in (0, 1) if estimate.deviations[k] > limits[k]]
    if not poor:
        is_paper = config.estimator.kind is EstimatorKind.EKF
        return LACKS["exact" if is_paper else "settled"]
    known = []
    for k in poor:
        sd = min(float(estimate.deviations[k]), 20.0)
        spread = f"{100.0 * sd:.0f} %" if sd < 1.0 else f"a factor of {written(math.exp(sd), 2)}"
        known.append(f"{('G', 'Gn')[k]} is known to {spread}")
    sources, shares = _largest(budget, poor[0])
    remedies = "; or ".join(SOURCES[source].remedy for source in sources)
    return Advice(f"{', '.join(known)} only{shares}", remedies)


def _bend(summary: ContactSummary, estimate: Estimate, config: PipelineConfig) -> Advice:
    """Return what a press that hardly stiffened lacks."""
    geometry = config.geometry
    wanted = _BEYOND_BOUNDARY * max(estimate.boundary_strain, summary.max_strain)
    compression = geometry.compression(wanted)
    sentence, remedy = LACKS["bend"].of(
        strain=summary.max_strain,
        boundary=estimate.boundary_strain,
        depth=written(1e3 * geometry.length * compression, 2),
    )
    known = "G is known, " if estimate.knows(0) else ""
    sources, shares = _largest(summary.budget, 1)
    if "law" in sources:
        # Deeper than any strain at which tissue stiffens, a delay makes the curve straight.
        remedy = SOURCES["law"].remedy
    elif compression >= _LARGEST_COMPRESSION:
        remedy = ""
    return Advice(f"{known}{sentence}{shares}", remedy)


def _largest(budget: Budget | None, index: int) -> tuple[Sequence[str], str]:
    """Return the largest source of the variance of ln G or ln Gn, and its share in words.

    With the next one where that is nearly as large. The uncertainty of Gn and alpha follows from
    the others, which come first.
    """
    names = budget.largest(index) if budget is not None else ()
    if budget is None or not names:
        return ("prior",), ""
    shares = {one: budget.share(one, index) for one in names if one != "prior"} or {
        "prior": budget.share("prior", index)
    }
    near = [one for one, share in shares.items() if share > _NEAR * max(shares.values())][:2]
    words = (
        f"{100.0 * shares[one]:.0f} % of the variance: {SOURCES[one].sentence}" for one in near
    )
    return near, f" ({'; '.join(words)})"
