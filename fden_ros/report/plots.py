# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The pictures of a report, as SVG for its page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from fden_ros.core.arrays import Array
from fden_ros.core.law import Geometry, StressMoments, elastic_response, memory_weights
from fden_ros.core.outputs import ContactSummary, TissueState
from fden_ros.core.streams import NANOSECONDS
from fden_ros.offline.session import Contact, Session
from fden_ros.report import style
from fden_ros.report.style import ESTIMATE, MEASURED, MUTED, SHADE, TRUTH, draw
from fden_ros.written import written

#: Makes the logarithm of 0 finite.
_TINY = 1e-300
_PARAMETERS = (("linear_stiffness", "G [Pa s^α]"), ("nonlinear_stiffness", "Gn"))


# Across the session


def overview(session: Session) -> str:
    """Force and displacement over the whole recording, contacts shaded and numbered."""
    time, ends = session.trace.arrays()
    summaries = [one.summary for one in session.contacts if one.summary is not None]

    def plot(figure: Figure) -> None:
        panels = figure.subplots(2, 1, sharex=True)
        named = ("force [N]", 1.0), ("displacement [mm]", 1e3)
        for number, (axes, (name, scale)) in enumerate(zip(panels, named, strict=True)):
            # A zigzag line: where there is one value only, a band has no width.
            values = scale * ends[:, 2 * number : 2 * number + 2].ravel()
            axes.plot(np.repeat(time, 2), values, color=MEASURED, linewidth=0.9)
            axes.set_ylabel(name)
            for one in summaries:
                span = session.seconds(one.start_ns), session.seconds(one.end_ns)
                axes.axvspan(*span, color=SHADE, zorder=0, linewidth=0)
        middles = [session.seconds((one.start_ns + one.end_ns) // 2) for one in summaries]
        for k in _apart([(x, 0.0) for x in middles], 0.05 * np.ptp(time), 1.0):
            panels[0].annotate(str(summaries[k].contact_id), (middles[k], 1.0), ha="center",
                               va="bottom", xycoords=("data", "axes fraction"), fontsize=8,
                               color=MUTED)  # fmt: skip
        panels[1].set_xlabel("time [s]")
        figure.align_ylabels()

    return draw(plot)


def _apart(places: Sequence[tuple[float, float]], width: float, height: float) -> list[int]:
    """Return which of some places can have labels of a size that do not overlap."""
    kept: list[int] = []
    for k, (x, y) in enumerate(places):
        others = (places[other] for other in kept)
        if all(abs(x - at[0]) > width or abs(y - at[1]) > height for at in others):
            kept.append(k)
    return kept


def comparison(session: Session) -> str:
    """G and Gn of every contact with their intervals."""
    known = [s for s in session.replay.summaries if s.estimate is not None]

    def plot(figure: Figure) -> None:
        for index, axes in enumerate(figure.subplots(2, 1, sharex=True)):
            key, title = _PARAMETERS[index]
            for converged, colour, name in ((True, ESTIMATE, ""), (False, MUTED, "not ")):
                chosen = [s for s in known if s.estimate and s.estimate.knows(index) is converged]
                if chosen:
                    numbers, label = [s.contact_id for s in chosen], f"{name}converged, ±2 sd"
                    values = style.interval([s.estimate for s in chosen], index)
                    style.intervals(axes, numbers, values, "o", color=colour, label=label)
            true = [(s.contact_id, session.truth[s.site_id][key])
                    for s in known if s.site_id in session.truth]  # fmt: skip
            truth = np.array(true).reshape(-1, 2).T
            if true:
                axes.plot(*truth, "_", color=TRUTH, markersize=14, label="truth")
            shown = style.interval([s.estimate for s in known], index)
            style.limit_by_intervals(axes, *(np.append(part, truth[1]) for part in shown))
            axes.set_title(title)
            style.write_ticks(axes)
            axes.locator_params(axis="x", integer=True)
            axes.margins(x=0.08)
            axes.grid(axis="x", visible=False)
        axes.set_xlabel("contact")
        style.legend_above(figure.axes[0])

    return draw(plot)


def site_map(session: Session) -> str:
    """Where it was pressed, seen along the approach: a dot, N/m and its colour for each site."""
    sites = list({s.site_id: s for s in session.replay.summaries if s.position}.values())
    # The axes of the frame that are least along the approach.
    axis = np.abs(session.parameters.displacement.axis)
    first, second = sorted(np.argsort(axis, kind="stable")[:2])
    positions = 1e3 * np.array([s.position for s in sites])
    x, y = positions[:, first], positions[:, second]
    values = np.array([getattr(s.apparent_stiffness, "value", math.nan) for s in sites])

    def plot(figure: Figure) -> None:
        axes = figure.add_subplot()
        # Room for the labels, also where all places coincide.
        room = 0.15 * max(np.ptp(x), np.ptp(y)) + 2.0
        axes.set_xlim(x.min() - room, x.max() + room)
        axes.set_ylim(y.min() - room, y.max() + 1.5 * room)
        axes.set_aspect("equal")
        axes.scatter(x, y, s=120, c="none", edgecolors=MUTED)
        is_known = np.isfinite(values)
        dots = axes.scatter(x[is_known], y[is_known], s=120, c=values[is_known], cmap="viridis")
        if len(set(values[is_known])) > 1:
            figure.colorbar(dots, label="N/m")
        for k in _apart(list(zip(x, y, strict=True)), 0.4 * room + np.ptp(x) / 6, 0.5 * room):
            size = f"{written(values[k], 3)} N/m" if is_known[k] else "not known"
            axes.annotate(f"{sites[k].site_id}: {size}", (x[k], y[k]), xytext=(0, 9),
                          textcoords="offset points", ha="center")  # fmt: skip
        frame = sites[0].position_frame
        axes.set_title(f"Sites and their stiffness{f' in {frame}' if frame else ''}")
        axes.set_xlabel(f"{'xyz'[first]} [mm]")
        axes.set_ylabel(f"{'xyz'[second]} [mm]")

    return draw(plot)


def path(summaries: Sequence[ContactSummary]) -> str:
    """N/m and alpha of the places of a continuous contact, over the way, or without it time."""
    places = [one for one in summaries if one.is_of_path]
    at, label = [(one.end_ns - places[0].start_ns) / NANOSECONDS for one in places], "time [s]"
    if all(one.position is not None for one in places):
        steps = np.diff(np.array([one.position for one in places]), axis=0)
        way = np.cumsum(np.linalg.norm(steps, axis=1))
        at, label = [0.0, *(1e3 * way).tolist()], "along the path [mm]"
    found = {
        "N/m": [(s.value, s.sd) if (s := one.apparent_stiffness) else None for one in places],
        "α": [
            (e.fractional_order, e.fractional_order_sd) if (e := one.estimate) else None
            for one in places
        ],
    }

    def plot(figure: Figure) -> None:
        panels = figure.subplots(2, 1, sharex=True)
        for axes, (title, values) in zip(panels, found.items(), strict=True):
            known = [(x, *one) for x, one in zip(at, values, strict=True) if one is not None]
            x, value, sd = np.array(known, dtype=float).reshape(-1, 3).T
            style.intervals(axes, x, (value, value - 2.0 * sd, value + 2.0 * sd), "o-")
            axes.set_title(f"{title}, ±2 sd")
        axes.set_xlabel(label)

    return draw(plot)


# One contact


def signals(session: Session, contact: Contact) -> str:
    """Depth and force of a contact, and the force that was predicted."""
    geometry = session.config.geometry
    states = [state for state in contact.states if state.signals is not None]
    seconds, per_force = _since_touch(states), geometry.stress_per_force
    last = states[-1].estimate
    ratios = np.array([geometry.compression(s.signals.strain) for s in states])
    if last is not None:  # a state's depth is from the surface as it was known by then
        ratios += [s.estimate.contact_point - last.contact_point if s.estimate else 0.0
                   for s in states]  # fmt: skip
    depth = 1e3 * geometry.length * ratios
    force = np.array([s.signals.stress / per_force for s in states])
    predicted = [
        math.nan if s.innovation is None else s.innovation.predicted_stress / per_force
        for s in states
    ]

    def plot(figure: Figure) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
        upper.plot(seconds, depth, color=MEASURED)
        upper.set_ylabel("depth [mm]")
        upper.set_title("Depth and force")
        lower.plot(seconds, force, color=MEASURED, label="measured")
        if np.isfinite(predicted).any():
            label = "predicted, one step ahead"
            lower.plot(seconds, predicted, color=ESTIMATE, linestyle="--", label=label)
        style.limit_by(lower, force, 0.25)
        lower.set_ylabel("force [N]")
        lower.set_xlabel("time since the touch [s]")
        lower.legend(loc="upper right", ncols=2)
        figure.align_ylabels()

    return draw(plot)


def characteristic(session: Session, contact: Contact, summary: ContactSummary) -> str:
    """Fractional stress against strain, with the fitted law and its band."""
    points = _points(session.config.geometry, contact, summary)

    def plot(figure: Figure) -> None:
        axes = figure.add_subplot()
        axes.plot(*points.T, ".", color=MEASURED, markersize=3, label="measured")
        estimate = summary.estimate
        if estimate is not None:
            strain = np.linspace(0.0, max(summary.max_strain, 1e-6), 120)
            g, g_n = estimate.linear_stiffness, estimate.nonlinear_stiffness
            response = np.array([elastic_response(x, g, g_n).value for x in strain])
            # d ln phi by (ln G, ln Gn).
            gradient = np.array([np.ones_like(strain), np.maximum(g_n * strain - 1.0, 0.0)])
            variance = np.einsum("in,ij,jn->n", gradient, estimate.covariance[:2, :2], gradient)
            logs, spread = np.log(response + _TINY), 2.0 * np.sqrt(np.maximum(variance, 0.0))
            style.band(axes, strain, style.exp(logs - spread), style.exp(logs + spread))
            axes.plot(strain, response, color=ESTIMATE, label="FDEN")
            if estimate.boundary_strain < summary.max_strain:
                axes.axvline(estimate.boundary_strain, color=MUTED, linestyle=":", label="1/Gn")
        axes.set_title("Fractional stress against strain")
        axes.set_xlabel("strain")
        axes.set_ylabel("f' [Pa s^α]")
        style.write_ticks(axes)
        style.limit_by(axes, points[:, 1], 0.3)
        axes.legend(loc="upper left")

    return draw(plot)


def _points(geometry: Geometry, contact: Contact, summary: ContactSummary) -> Array:
    """Return strains and fractional stresses at the last alpha and origin, shape (n, 2).

    A state has those of its own time: a later alpha scales them.
    """
    last, moments = summary.estimate, StressMoments()
    points: list[tuple[float, float]] = []
    stamp_ns, stress = math.inf, 0.0
    for state in contact.states:
        if state.signals is None:
            continue
        strain, now = state.signals.strain, state.signals.stress
        response = state.signals.fractional_stress
        if state.stamp_ns > stamp_ns:
            moments.add((state.stamp_ns - stamp_ns) / NANOSECONDS, stress, now)
        stamp_ns, stress = state.stamp_ns, now
        if last is not None and (then := state.estimate) is not None:
            orders = last.fractional_order, then.fractional_order
            changed = memory_weights(orders[0]) - memory_weights(orders[1])
            response += float(changed @ np.append(moments.values, now))
            moved = then.contact_point - last.contact_point
            strain = geometry.strain(geometry.compression(strain) + moved)
        points.append((strain, response))
    return np.array(points).reshape(-1, 2)


def convergence(contact: Contact, truth: dict[str, Any] | None) -> str:
    """How G and Gn converged."""
    states = [s for s in contact.states if s.estimate is not None]
    estimates = [s.estimate for s in states]
    time = _since_touch(states)

    def plot(figure: Figure) -> None:
        for index, axes in enumerate(figure.subplots(2, 1, sharex=True)):
            key, label = _PARAMETERS[index]
            value, low, high = style.interval(estimates, index)
            is_known = np.array([e.knows(index) for e in estimates], dtype=bool)
            style.band(axes, time, low, high)
            axes.plot(time, value, color=ESTIMATE, linewidth=1.0, label="estimate")
            known = np.where(is_known, value, np.nan)
            axes.plot(time, known, color=ESTIMATE, linewidth=2.4, label="converged")
            if truth is not None:
                axes.axhline(truth[key], color=TRUTH, linestyle=":", label="truth")
            final = float(value[-1])
            away = np.abs(np.concatenate([low, high]) - final)
            half = 1.3 * min(float(np.quantile(away, 0.9)), 2.0 * final) + 0.02 * final
            axes.set_ylim(max(final - half, 0.0), final + half)
            axes.set_ylabel(label)
            style.write_ticks(axes)
        figure.axes[0].set_title("The estimate")
        style.legend_above(figure.axes[0])
        axes.set_xlabel("time since the touch [s]")
        figure.align_ylabels()

    return draw(plot)


def _since_touch(states: Sequence[TissueState]) -> Array:
    """Return the times of states since the first [s], shape (n,)."""
    return np.array([(s.stamp_ns - states[0].stamp_ns) / NANOSECONDS for s in states])
