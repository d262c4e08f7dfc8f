# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The relaxation and the stress-strain curve that the data want, beside those of the law."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.law_error import LawCurve
from fden_ros.core.law.characteristic import phi
from fden_ros.core.outputs import ContactSummary
from fden_ros.report.style import ESTIMATE, MEASURED, band, draw

_SIZE = (10.8, 2.9)


def law_picture(summary: ContactSummary) -> str | None:
    """Return the drawing of a contact whose deviation from the law was found, else None."""
    estimate, curves = summary.estimate, summary.law_curves
    if estimate is None or estimate.law_error is None or curves is None:
        return None
    error, found = estimate.law_error, curves
    log_g, log_gn, order = curves.mean.tolist()

    def plot(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        times = found.kernel.points
        _draw(left, times**-order, found.kernel)
        left.set_xscale("log")
        left.set_yscale("log")
        left.set_title(f"Relaxation, {error.kernel:.3f} ± {error.kernel_sd:.3f} off the law")
        left.set_xlabel("time [s]")
        left.set_ylabel("stress after a unit step [1]")
        strains = found.characteristic.points
        _draw(right, phi(strains, math.exp(log_g), math.exp(log_gn)), found.characteristic)
        right.set_title(
            f"Elastic response, {error.characteristic:.3f} ± {error.characteristic_sd:.3f} off, "
            f"{error.loaded:.3f} where loaded"
        )
        right.set_xlabel("strain")
        right.set_ylabel("φ [Pa s^α]")
        right.legend(loc="upper left")

    return draw(plot, _SIZE)


def _draw(axes: Axes, law: Array, curve: LawCurve) -> None:
    low, wanted, high = (law * np.exp(curve.value + k * curve.sd) for k in (-2.0, 0.0, 2.0))
    band(axes, curve.points, low, high, MEASURED)
    axes.plot(curve.points, wanted, color=MEASURED, label="what the data want")
    axes.plot(curve.points, law, color=ESTIMATE, linestyle="--", label="FDEN")
