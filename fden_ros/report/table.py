# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Contacts as a table for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from fden_ros.core.estimation.estimate import ParameterSet
from fden_ros.core.outputs import ContactSummary, Flag

DASH = "–"
#: Values within these have decimal places, others significant digits.
_SMALL, _LARGE = 1e-2, 1e7
#: Significant digits of a value.
_DIGITS = 4
#: A stiffness whose deviation is larger by this factor is not shown.
_UNKNOWN = 10.0


def contact_table(
    summaries: Iterable[ContactSummary], truth: Mapping[int, Mapping[str, Any]] | None = None
) -> Table:
    """Return one row a contact, of at most 80 columns.

    Parameters
    ----------
    summaries : iterable of ContactSummary
    truth : mapping, optional
        Site number to its true ``linear_stiffness`` and ``nonlinear_stiffness``, shown below the
        estimates.
    """
    shown = list(summaries)
    on_path = any(summary.is_of_path for summary in shown)
    table = Table(title="Places" if on_path else "Contacts", box=box.SIMPLE_HEAD, padding=0)
    for name in ("#", "site", "G [Pa s^α]", "Gn", "α", "N/m"):
        table.add_column(Text(name), justify="right", no_wrap=True)
    table.add_column("status", min_width=10)
    table.add_column("tissue", min_width=12)
    for summary in shown:
        table.add_row(*_cells(summary, truth, on_path=on_path))
        if summary.is_of_path:
            table.caption = "contact.mode continuous: dF/dd and α at places on the path"
        elif summary.estimate is not None and summary.estimate.valid != ParameterSet.ALL:
            table.caption = "in brackets: prior knowledge, which the data did not determine"
    return table


def plus_minus(value: float, deviation: float, most_digits: int = 17) -> str:
    """Return value ± deviation, with two digits of the deviation.

    The value has at most `most_digits` significant digits.
    """
    if not deviation > 0.0 or not math.isfinite(deviation):
        return f"{value:.4g}"
    if not _SMALL <= abs(value) < _LARGE or deviation >= _LARGE:
        return f"{value:.3g} ± {deviation:.2g}"
    places = 1 - math.floor(math.log10(deviation))
    places = max(0, min(places, most_digits - 1 - math.floor(math.log10(abs(value)))))
    shown = f"{deviation:.{places}f}"
    return f"{value:.{places}f} ± {shown if float(shown) else f'{deviation:.1g}'}"


def status_words(summary: ContactSummary, *, on_path: bool = False) -> str:
    """Return how far a contact's parameters are known, and its flags.

    `on_path`: it is one of the places on the path of a continuous contact, where none has an
    origin.
    """
    words = "not converged"
    if on_path:
        words = "stiffness" if summary.is_of_path else "no stiffness yet"
    elif summary.converged:
        words = "converged"
    elif summary.estimate is not None and ParameterSet.LINEAR_STIFFNESS in summary.estimate.known:
        words = "G known"
    parts = [words] if summary.complete else [words, "cut short"]
    parts += [
        flag.name.lower().replace("_", " ")
        for flag in Flag
        if flag and flag.name and flag & summary.flags
        if not (flag is Flag.ORIGIN_UNCERTAIN and on_path)
    ]
    return ", ".join(parts)


def _cells(
    summary: ContactSummary, truth: Mapping[int, Mapping[str, Any]] | None, *, on_path: bool
) -> list[str]:
    estimate, stiffness = summary.estimate, summary.apparent_stiffness
    g = g_n = alpha = DASH
    if estimate is not None:
        g, g_n, alpha = (
            text if estimate.determines(index) else f"({text})"
            for index, text in enumerate(
                (
                    plus_minus(estimate.linear_stiffness, estimate.linear_stiffness_sd, _DIGITS),
                    plus_minus(
                        estimate.nonlinear_stiffness, estimate.nonlinear_stiffness_sd, _DIGITS
                    ),
                    f"{estimate.fractional_order:.3f}",
                )
            )
        )
    if summary.is_of_path:
        g = DASH
        g_n = g_n if estimate is not None and estimate.determines(1) else DASH
    site = (truth or {}).get(summary.site_id)
    if site is not None and not summary.is_of_path:
        g += f"\n[dim]true {site['linear_stiffness']:.0f}[/dim]"
        g_n += f"\n[dim]true {site['nonlinear_stiffness']:.2f}[/dim]"
    apparent = DASH
    is_plausible = Flag.IMPLAUSIBLE not in summary.flags
    if stiffness is not None and is_plausible and stiffness.sd < _UNKNOWN * stiffness.value:
        apparent = plus_minus(stiffness.value, stiffness.sd, _DIGITS)
    numbers = (str(summary.contact_id), str(summary.site_id), g, g_n, alpha, apparent)
    label = DASH if on_path else label_words(summary)
    return [*numbers, status_words(summary, on_path=on_path), label]


def label_words(summary: ContactSummary) -> str:
    """Return which tissue it is, as far as that is said."""
    return summary.classes.words if summary.classes is not None else "undetermined"
