"""Contacts as a table for the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from rich import box
from rich.table import Table

from fden_ros.core.outputs import ContactSummary, Flag

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
    table = Table(title="Contacts", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for name in ("#", "site", "G [Pa s^α]"):
        table.add_column(name, justify="right", no_wrap=True)
    if truth is not None:
        table.add_column("true", justify="right", style="dim", no_wrap=True)
    table.add_column("Gn", justify="right", no_wrap=True)
    if truth is not None:
        table.add_column("true", justify="right", style="dim", no_wrap=True)
    table.add_column("α", justify="right", no_wrap=True)
    table.add_column("status")
    table.add_column("tissue", no_wrap=True)
    for summary in summaries:
        table.add_row(*_cells(summary, truth))
    return table


def status_words(summary: ContactSummary) -> str:
    """Return whether a contact is converged, and if not because nothing can be, why."""
    words = "converged" if summary.converged else "not converged"
    if summary.flags & Flag.GEOMETRY_UNSTATED:
        words = "no geometry"
    elif summary.flags & Flag.IMPLAUSIBLE:
        words = "implausible"
    return words if summary.complete else f"{words}, cut short"


def _cells(summary: ContactSummary, truth: Mapping[int, Mapping[str, Any]] | None) -> list[str]:
    estimate = summary.estimate
    g = g_n = alpha = DASH
    if estimate is not None:
        g = f"{estimate.linear_stiffness:.1f} ± {estimate.linear_stiffness_sd:.1f}"
        g_n = f"{estimate.nonlinear_stiffness:.2f} ± {estimate.nonlinear_stiffness_sd:.2f}"
        alpha = f"{estimate.fractional_order:.3f}"
    site = (truth or {}).get(summary.site_id)
    cells = [str(summary.contact_id), str(summary.site_id), g]
    if truth is not None:
        cells.append(f"{site['linear_stiffness']:.1f}" if site else DASH)
    cells.append(g_n)
    if truth is not None:
        cells.append(f"{site['nonlinear_stiffness']:.2f}" if site else DASH)
    return [*cells, alpha, status_words(summary), _label(summary)]


def _label(summary: ContactSummary) -> str:
    if summary.classes is None:
        return "undetermined"
    return summary.classes.words
