# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables for the terminal; that of contacts."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

from rich import box
from rich.table import Table
from rich.text import Text

from fden_ros.core.estimation import ParameterSet
from fden_ros.core.outputs import ContactSummary, Flag, is_path
from fden_ros.offline.known import known_stiffness
from fden_ros.report.numbers import DASH, bracketed, order, parameter, slope, stiffness

#: Significant digits of a value, and of N/m, so that the table keeps to 80 columns.
_DIGITS, _STIFFNESS_DIGITS = 4, 3
_SLOPE = "slope: measured dF/dd in N/m at the end of loading, and its depth in mm"
_PATH = (
    "contact.mode continuous: dF/dd and α at places on the path; slope: measured dF/dd in N/m "
    "of the newest loading"
)
_NUMBERS = ("#", "site", "G [Pa s^α]", "Gn", "α", "N/m", "slope at mm")


def table_of(
    columns: Mapping[str, int],
    rows: Iterable[Sequence[str]],
    title: str | None = None,
    between: int = 1,
) -> Table:
    """Return a table of cells in rich's markup, with blanks `between` two columns.

    `columns`: heading to the least width of a column of words; 0: one of numbers. Without
    blanks between them there are none at the edges either.
    """
    table = Table(
        title=title, box=box.SIMPLE_HEAD, padding=(0, between, 0, 0), show_edge=between > 0
    )
    cells = list(rows)
    for number, (heading, width) in enumerate(columns.items()):
        if width:
            words = [len(word) for row in cells for word in row[number].split()]
            table.add_column(Text(heading), min_width=max([width, *words]), overflow="fold")
        else:
            table.add_column(Text(heading), justify="right", no_wrap=True)
    for row in cells:
        table.add_row(*row)
    return table


def contact_table(
    summaries: Iterable[ContactSummary], alone: Collection[int] = frozenset()
) -> Table:
    """Return one row per contact, of at most 80 columns.

    `alone`: numbers of the contacts with known N/m or slope, but not G.
    """
    shown = list(summaries)
    on_path = is_path(shown)
    rows = [_cells(s, on_path=on_path, alone=s.contact_id in alone) for s in shown]
    columns = {**dict.fromkeys(_NUMBERS, 0), "status": 9, "tissue": 5}
    if all(row[-1] == DASH for row in rows):
        del columns["tissue"]
        rows = [row[:-1] for row in rows]
    table = table_of(columns, rows, "Places" if on_path else "Contacts", between=0)
    table.caption = _PATH if on_path else _SLOPE
    if not on_path and any(cell.startswith("(") for row in rows for cell in row):
        table.caption += "; in brackets: not determined by the data"
    return table


def status_words(summary: ContactSummary, *, on_path: bool = False, alone: bool = False) -> str:
    """Return how far a contact's parameters are known, and its flags.

    `on_path`: it is a place on the path of a continuous contact. `alone`: its N/m or slope is
    known, but not G.
    """
    words = "not converged"
    if on_path:
        words = "stiffness" if summary.is_of_path else "no stiffness yet"
    elif summary.converged:
        words = "converged"
    elif summary.estimate is not None and ParameterSet.LINEAR_STIFFNESS in summary.estimate.known:
        words = "G known"
    elif alone:
        words = f"{known_stiffness(summary)} known"
    parts = [words] if summary.complete else [words, "cut short"]
    parts += [
        flag.name.lower().replace("_", " ")
        for flag in Flag
        if flag and flag.name and flag & summary.flags
        if not (flag is Flag.TOUCH_NOT_OBSERVED and on_path)
    ]
    return ", ".join(parts)


def label_words(summary: ContactSummary) -> str:
    """Return the tissue, as far as it is known."""
    return summary.classes.words if summary.classes is not None else "undetermined"


def _cells(summary: ContactSummary, *, on_path: bool, alone: bool) -> list[str]:
    estimate = summary.estimate
    g = g_n = alpha = DASH
    if estimate is not None:
        g, g_n = (parameter(estimate, index, _DIGITS) for index in (0, 1))
        alpha = order(estimate, with_deviation=False)
        if alone:
            g, g_n = bracketed(g), bracketed(g_n)
        if summary.is_of_path:
            g, g_n = DASH, g_n if estimate.determines(1) else DASH
    is_plausible = Flag.IMPLAUSIBLE not in summary.flags
    return [
        str(summary.contact_id),
        str(summary.site_id),
        g,
        g_n,
        alpha,
        stiffness(summary.apparent_stiffness, _STIFFNESS_DIGITS) if is_plausible else DASH,
        slope(summary.measured.loading),
        status_words(summary, on_path=on_path, alone=alone),
        DASH if on_path or summary.classes is None else label_words(summary),
    ]
