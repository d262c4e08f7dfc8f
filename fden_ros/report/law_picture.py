# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The relaxation and the stress-strain curve that the data want, beside those of the law."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.contact_record import ContactRecord
from fden_ros.core.estimation.estimator import Block
from fden_ros.core.estimation.law_deviation import Deviation, LawDeviation
from fden_ros.core.estimation.law_fit import LawFit, is_enough
from fden_ros.core.estimation.unmodelled import LoadingAge
from fden_ros.core.law.characteristic import elastic_response, phi
from fden_ros.core.outputs import ContactSummary
from fden_ros.core.streams.samples import NANOSECONDS
from fden_ros.offline.session import Contact, Session
from fden_ros.parameters import pipeline_config
from fden_ros.report.style import ESTIMATE, MEASURED, band, draw

_SIZE = (10.8, 2.9)


def law_picture(session: Session, contact: Contact, summary: ContactSummary) -> str | None:
    """Return the drawing of a contact whose deviation from the law was found, else None."""
    estimate = summary.estimate
    if estimate is None or estimate.law_error is None:
        return None
    deviation = deviation_of(session, contact, summary)
    if deviation is None:
        return None
    found, error = deviation, estimate.law_error

    def plot(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        times = found.kernel.points
        _draw(left, times, times**-found.fractional_order, found.kernel)
        left.set_xscale("log")
        left.set_yscale("log")
        left.set_title(f"Relaxation, {error.kernel:.3f} ± {error.kernel_sd:.3f} off the law")
        left.set_xlabel("time [s]")
        left.set_ylabel("stress after a unit step [1]")
        strains = found.characteristic.points
        gn = math.exp(found.log_nonlinear_stiffness)
        law = phi(strains, math.exp(found.log_linear_stiffness), gn)
        _draw(right, strains, law, found.characteristic)
        right.set_title(
            f"Elastic response, {error.characteristic:.3f} ± {error.characteristic_sd:.3f} off, "
            f"{error.loaded:.3f} where loaded"
        )
        right.set_xlabel("strain")
        right.set_ylabel("φ [Pa s^α]")
        right.legend(loc="upper left")

    return draw(plot, _SIZE)


def deviation_of(
    session: Session, contact: Contact, summary: ContactSummary
) -> LawDeviation | None:
    """Return the deviation from the law over a contact's states; None where no fit is found."""
    estimate, geometry = summary.estimate, session.geometry
    assert estimate is not None
    record, age = ContactRecord(), LoadingAge()
    before = 0.0
    for state in contact.states.items:
        time = (state.stamp_ns - summary.start_ns) / NANOSECONDS
        if state.signals is None or time <= before:
            continue
        strain = max(state.signals.strain, 0.0)
        response = elastic_response(strain, 1.0, estimate.nonlinear_stiffness).value
        age.grow(time - before, response)
        compression, stress = geometry.compression(strain), state.signals.stress
        record.add(Block(compression, stress, time, 1, time - before, np.zeros(1)), age.age)
        before = time
    if not is_enough(record):
        return None
    config = pipeline_config(session.parameters).estimator
    start = np.append(estimate.mean, 0.0)
    variances = [s.innovation.variance for s in contact.states.items if s.innovation is not None]
    noise_sd = math.sqrt(float(np.median(variances))) if variances else 0.0
    fit = LawFit(record, noise_sd, geometry, config.prior, config.uncertainty, start, 0.0)
    try:
        for _ in fit.steps():
            pass
    except (np.linalg.LinAlgError, ValueError):
        return None
    return fit.result()


def _draw(axes: Axes, points: Array, law: Array, deviation: Deviation) -> None:
    low, wanted, high = (
        law * np.exp(deviation.value + k * deviation.sd) for k in (-2.0, 0.0, 2.0)
    )
    band(axes, points, low, high, MEASURED)
    axes.plot(points, wanted, color=MEASURED, label="what the data want")
    axes.plot(points, law, color=ESTIMATE, linestyle="--", label="FDEN")
