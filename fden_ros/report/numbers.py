# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Numbers with their standard deviation, as tables, pages and the node's log print them."""

from __future__ import annotations

import math

from fden_ros.core.estimation import Estimate
from fden_ros.core.outputs import ApparentStiffness
from fden_ros.core.stiffness import MeasuredSlope
from fden_ros.written import written

DASH = "–"
#: Values within these have decimal places, others significant digits.
_SMALL, _LARGE = 1e-2, 1e7
#: A deviation below this share of its value is rounding.
_EXACT = 1e-9
#: Below this many standard deviations a number of the order of 1 lies with 95 %.
_UPPER = 1.645
#: A bound this many times the value is useless.
_VAGUE = 100.0


def plus_minus(value: float, deviation: float, most_digits: int = 17) -> str:
    """Return value ± deviation, with two digits of the deviation.

    The value has at most `most_digits` significant digits.
    """
    if not deviation > _EXACT * abs(value) or not math.isfinite(deviation):
        return written(value, 4)
    if not _SMALL <= abs(value) < _LARGE or deviation >= _LARGE:
        return f"{written(value, 3)} ± {written(deviation, 2)}"
    places = 1 - math.floor(math.log10(deviation))
    first = -math.floor(math.log10(abs(value)))
    places = max(min(places, most_digits - 1 + first), first)
    shown = _rounded(deviation, places)
    return f"{_rounded(value, places)} ± {shown if shown.strip('0.') else written(deviation, 1)}"


def _rounded(value: float, places: int) -> str:
    """Return a number to some decimal places; negative: to tens, hundreds ..."""
    return f"{round(value, places):,.{max(places, 0)}f}"


def result(
    value: float, deviation: float, most_digits: int = 17, *, is_of_data: bool = True
) -> str:
    """Return a positive number with its deviation, to first order, as a result.

    A number in brackets is not determined by the data. A value no larger than its own standard
    deviation is stated by its upper bound at 95 %: its logarithm is normal, with `deviation` /
    `value`.
    """
    if not is_of_data:
        return f"({plus_minus(value, deviation, most_digits)})"
    if deviation < value:
        return plus_minus(value, deviation, most_digits)
    times = math.exp(min(_UPPER * deviation / value, 600.0))
    return f"below {_rounded_up(times * value)}" if times <= _VAGUE else DASH


def parameter(estimate: Estimate, index: int, most_digits: int = 17) -> str:
    """Return G or Gn (`index` 0 or 1) of an estimate as a result."""
    value = math.exp(min(float(estimate.mean[index]), 600.0))
    deviation = value * float(estimate.deviations[index])
    return result(value, deviation, most_digits, is_of_data=estimate.determines(index))


def order(estimate: Estimate, *, with_deviation: bool = True) -> str:
    """Return alpha as a result: in brackets where it is the prior's."""
    text = f"{estimate.fractional_order:.3f}"
    if with_deviation:
        text = plus_minus(estimate.fractional_order, estimate.fractional_order_sd)
    return text if estimate.determines(2) else f"({text})"


def stiffness(found: ApparentStiffness | MeasuredSlope | None, most_digits: int = 17) -> str:
    """Return the stiffness [N/m] as a result; a dash where there is none."""
    return DASH if found is None else result(found.value, found.sd, most_digits)


def bracketed(text: str) -> str:
    """Return a number in the form for one that the data did not determine."""
    return text if text == DASH or text.startswith("(") else f"({text})"


def slope(found: MeasuredSlope | None) -> str:
    """Return a measured slope [N/m] and its depth [mm], to the first digit of its deviation."""
    if found is None:
        return DASH
    digits = 1 + math.floor(math.log10(found.value)) - math.floor(math.log10(found.sd))
    return written(found.value, max(1, min(digits, 4))) + _at(found, "")


def slope_words(found: MeasuredSlope | None) -> str:
    """Return a measured slope with its deviation, unit and depth; a dash where there is none."""
    return DASH if found is None else f"{stiffness(found, 4)} N/m{_at(found, ' mm')}"


def _at(found: MeasuredSlope, unit: str) -> str:
    """Return the depth of a slope in words; empty where it is not known."""
    return "" if math.isnan(found.depth) else f" at {written(1e3 * found.depth, 2)}{unit}"


def law(estimate: Estimate | None) -> str:
    """Return how far the tissue deviates from the law; empty where that is not known."""
    error = estimate.law_error if estimate is not None else None
    if estimate is None or error is None:
        return ""
    text = (
        f"relaxation {error.kernel:.3f} ± {error.kernel_sd:.3f}, "
        f"stress-strain curve {error.characteristic:.3f} ± {error.characteristic_sd:.3f}"
    )
    plateau = estimate.plateau_probability
    return text if math.isnan(plateau) else f"{text}; probability of a plateau {plateau:.2f}"


def _rounded_up(value: float) -> str:
    """Return a bound with two digits, rounded up."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    bound = step * math.ceil(value / step - 1e-9)
    return written(bound, 2)
