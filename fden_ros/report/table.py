"""Contacts as a table for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from rich.table import Table

from fden_ros.core.pipeline import ContactSummary

DASH = "–"


def contact_table(
    summaries: Iterable[ContactSummary], truth: Mapping[int, Mapping[str, Any]] | None = None
) -> Table:
    """Return one row a contact.

    Parameters
    ----------
    summaries : iterable of ContactSummary
    truth : mapping, optional
        Site number to its true ``linear_stiffness`` and ``nonlinear_stiffness``, shown beside the
        estimates.
    """
    table = Table(title="Contacts")
    for name in ("contact", "site", "duration s"):
        table.add_column(name, justify="right")
    table.add_column("G  Pa·s^α", justify="right")
    if truth is not None:
        table.add_column("true G", justify="right", style="dim")
    table.add_column("Gn", justify="right")
    if truth is not None:
        table.add_column("true Gn", justify="right", style="dim")
    table.add_column("α", justify="right")
    table.add_column("status")
    table.add_column("tissue")
    for summary in summaries:
        table.add_row(*_cells(summary, truth))
    return table


def _cells(summary: ContactSummary, truth: Mapping[int, Mapping[str, Any]] | None) -> list[str]:
    estimate = summary.estimate
    g = g_n = alpha = DASH
    if estimate is not None:
        deviations = [math.sqrt(estimate.covariance[i, i]) for i in range(3)]
        value, value_n = (
            math.exp(estimate.log_linear_stiffness),
            math.exp(estimate.log_nonlinear_stiffness),
        )
        g = f"{value:.1f} ± {value * deviations[0]:.1f}"
        g_n = f"{value_n:.3f} ± {value_n * deviations[1]:.3f}"
        alpha = f"{estimate.fractional_order:.3f} ({summary.order_source.name.lower()})"
    cells = [
        str(summary.contact_id),
        str(summary.site_id),
        f"{(summary.end_ns - summary.start_ns) * 1e-9:.2f}",
        g,
    ]
    site = (truth or {}).get(summary.site_id)
    if truth is not None:
        cells.append(f"{site['linear_stiffness']:.1f}" if site else DASH)
    cells.append(g_n)
    if truth is not None:
        cells.append(f"{site['nonlinear_stiffness']:.3f}" if site else DASH)
    cells.append(alpha)
    status = "converged" if summary.converged else "not converged"
    cells.append(status if summary.complete else f"{status}, cut short")
    cells.append(_label(summary))
    return cells


def _label(summary: ContactSummary) -> str:
    if summary.classes is None:
        return "undetermined"
    return f"{summary.classes.label} ({max(summary.classes.probabilities):.0%})"
