# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What stands against a conclusion from one contact, in words."""

from __future__ import annotations

from collections.abc import Iterator

from fden_ros.core.config import PipelineConfig
from fden_ros.core.estimation import Estimate, ParameterSet
from fden_ros.core.outputs import ContactSummary, Flag
from fden_ros.offline.advice import shortfall
from fden_ros.written import written

#: What a flag stands for; ALPHA_PRIOR_CONFLICT has its numbers.
_BY_FLAG = {
    Flag.TOUCH_NOT_OBSERVED: (
        "The touch of this tissue was not observed: the force was there when the data began, it "
        "rose unseen in noise, or the probe was dragged here. There is no contact point, and no "
        "estimate for this site."
    ),
    Flag.GAP: "Samples are missing within this site's memory.",
    Flag.MODEL_MISMATCH: (
        "The law does not describe this contact: its N/m is withheld, the measured slope stands."
    ),
    Flag.TISSUE_CHANGED: (
        "The tissue changed within the contact: G is of the new one, Gn and alpha are of both."
    ),
    Flag.SATURATED: "The force was stuck or beyond force.limit, and was dropped.",
    Flag.FORCE_DRIFTED: (
        "The force in the air after a contact was not that before it, beyond force.drift_sd: the "
        "deviations are widened by as much."
    ),
    Flag.RIG_PRIOR_CONFLICT: (
        "Friction, delay or compliance is more than 2.5 standard deviations off what "
        "force.friction_sd, displacement.delay_sd and displacement.compliance_sd state: the "
        "deviations are widened."
    ),
    Flag.ESTIMATION_FAILED: (
        "The computation failed at this site: there is no estimate until the next one."
    ),
    Flag.GEOMETRY_UNSTATED: (
        "The geometry is not stated: the numbers are those of a probe that stands in for it."
    ),
    Flag.IMPLAUSIBLE: "Strain, force, rate or a size cannot be what it says: a unit may be wrong.",
}


def against_the_law(summary: ContactSummary) -> str:
    """Return in one line what stands against G and Gn of a contact that lacks nothing else."""
    estimate = summary.estimate
    against = [words for flag, words in _BY_FLAG.items() if summary.flags & flag]
    if estimate is not None and estimate.at_edge:
        against = [*_at_edge(estimate), *against]
    words = against[0] if against else "The data do not determine them."
    return f"{words[0].lower()}{words[1:]}".rstrip(".")


def remarks(
    summary: ContactSummary, config: PipelineConfig, *, alone: bool = False
) -> Iterator[str]:
    """Yield, in words, what stands against a conclusion; `alone`: N/m is known, and not G."""
    estimate = summary.estimate
    if alone:
        yield f"N/m known; G and Gn not: {against_the_law(summary)}."
    if not summary.complete:
        yield "The contact was cut short: its release is not in the recording, or data were lost."
    yield from (words for flag, words in _BY_FLAG.items() if summary.flags & flag)
    if summary.flags & Flag.ALPHA_PRIOR_CONFLICT and estimate is not None and estimate.law_error:
        error = estimate.law_error
        yield (
            f"The relaxation contradicts the stated alpha: it is that of {error.order:.3f} ± "
            f"{error.order_sd:.3f}. Leave alpha to the data, or state what this tissue has."
        )
    if summary.rejected_count:
        yield f"{summary.rejected_count} samples were rejected during the contact."
    if estimate is None:
        yield "There is no estimate."
    elif estimate.at_edge:
        yield from _at_edge(estimate)
    elif words := shortfall(summary, config):
        yield f"{words[0].upper()}{words[1:]}."
    if estimate is not None and not (
        estimate.at_edge or ParameterSet.FRACTIONAL_ORDER in estimate.observable
    ):
        yield (
            f"alpha is not determined by the data: {estimate.fractional_order:.3f} ± "
            f"{estimate.fractional_order_sd:.3f}, by the prior "
            f"{config.estimator.prior.fractional_order:.3f}."
        )


def _at_edge(estimate: Estimate) -> Iterator[str]:
    for parameter, words in (
        (
            ParameterSet.LINEAR_STIFFNESS,
            f"G ({written(estimate.linear_stiffness, 3)}): state another prior.linear_stiffness",
        ),
        (
            ParameterSet.NONLINEAR_STIFFNESS,
            f"Gn ({estimate.nonlinear_stiffness:.2f}): the prior excludes this tissue, or it is "
            "none that the model describes; state prior.nonlinear_stiffness with a "
            "prior.nonlinear_stiffness_log_sd of 1",
        ),
        (
            ParameterSet.FRACTIONAL_ORDER,
            f"alpha ({estimate.fractional_order:.3f}): the material relaxes less or more than any "
            "tissue that the model describes, or force and displacement are out of step",
        ),
    ):
        if parameter in estimate.at_edge:
            yield f"No estimate, but an end of the range of {words}."
