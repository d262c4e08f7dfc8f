# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The pictures of a report, as SVG for its page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fden_ros.core.arrays import Array
from fden_ros.core.law import Geometry, StressMoments, elastic_response, memory_weights
from fden_ros.core.outputs import ContactSummary, TissueState
from fden_ros.core.streams import NANOSECONDS
from fden_ros.offline.session import Contact, Session, predicted_stress
from fden_ros.offline.signals import Envelope
from fden_ros.parameters import unit_vector
from fden_ros.report import style
from fden_ros.report.style import ESTIMATE, MEASURED, MUTED, TRUTH, WIDE, draw
from fden_ros.written import written

#: Makes the logarithm of 0 finite.
_TINY = 1e-300
_PARAMETERS = (("linear_stiffness", style.G_LABEL), ("nonlinear_stiffness", style.GN_LABEL))


# Across the session


def overview(session: Session) -> str:
    """Force and displacement over the whole recording, contacts shaded."""

    def plot(figure: Figure) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True)
        _envelope(upper, session.force, session.start_ns, 1.0)
        _envelope(lower, session.displacement, session.start_ns, 1e3)
        spans = [
            (_seconds(s.start_ns, session), _seconds(s.end_ns, session))
            for s in session.replay.summaries
        ]
        for axes in (upper, lower):
            style.shade(axes, spans)
        for summary, span in zip(session.replay.summaries[:40], spans, strict=False):
            upper.annotate(
                str(summary.contact_id),
                (sum(span) / 2.0, 1.0),
                xycoords=("data", "axes fraction"),
                ha="center",
                va="bottom",
                fontsize=8,
                color=MUTED,
            )
        upper.set_ylabel("force [N]")
        lower.set_ylabel("displacement [mm]")
        lower.set_xlabel("time [s]")
        figure.align_ylabels()

    return draw(plot, WIDE)


def comparison(session: Session) -> str:
    """G and Gn of every contact with their intervals."""
    known = [s for s in session.replay.summaries if s.estimate is not None]

    def plot(figure: Figure) -> None:
        for index, axes in enumerate(figure.subplots(1, 2)):
            key, label = _PARAMETERS[index]
            for converged, colour, name in (
                (True, ESTIMATE, "converged, ±2 sd"),
                (False, MUTED, "not converged, ±2 sd"),
            ):
                chosen = [s for s in known if s.estimate and s.estimate.knows(index) is converged]
                if chosen:
                    numbers = [s.contact_id for s in chosen]
                    values = style.interval([s.estimate for s in chosen], index)
                    style.intervals(axes, numbers, *values, colour, name)
            true = [
                (s.contact_id, session.truth[s.site_id][key])
                for s in known
                if s.site_id in session.truth
            ]
            truth = np.array(true).reshape(-1, 2).T
            if true:
                axes.plot(*truth, "_", color=TRUTH, markersize=14, label="truth")
            axes.set_xlabel("contact")
            axes.set_title(label, loc="left")
            axes.yaxis.set_major_formatter(lambda value, _: written(value, 6))
            axes.locator_params(axis="x", integer=True)
            axes.margins(x=0.08)
            shown = style.interval([s.estimate for s in known], index)
            axes.set_ylim(*style.interval_limits(*(np.append(part, truth[1]) for part in shown)))
            axes.grid(axis="x", visible=False)
        style.legend_above(figure.axes[0])

    return draw(plot, WIDE)


def site_map(session: Session) -> str:
    """Where it was pressed, seen along the approach, with G as colour and number."""
    placed = [s for s in session.replay.summaries if s.position is not None]
    first, second = _lateral_axes(session.parameters.displacement.axis)

    def plot(figure: Figure) -> None:
        axes = figure.add_subplot()
        places = 1e3 * np.array([s.position for s in placed])
        x, y = places @ first, places @ second
        values = np.array(
            [s.estimate.linear_stiffness if s.estimate is not None else math.nan for s in placed]
        )
        axes.scatter(x, y, s=260, c="none", edgecolors=MUTED)
        if np.isfinite(values).any():
            low, high = style.interval_limits(values, values, values)
            axes.scatter(
                x, y, s=260, c=values, cmap="viridis", edgecolors=MUTED, vmin=low, vmax=high
            )
        for across, along, value, summary in zip(x, y, values, placed, strict=True):
            text = (
                f"{summary.contact_id}: {written(value, 4)}"
                if math.isfinite(value)
                else "no estimate"
            )
            axes.annotate(
                text, (across, along), xytext=(0, 12), textcoords="offset points", ha="center"
            )
        frame = placed[0].position_frame
        where = f" in {frame}" if frame else ""
        axes.set_title(f"Where it was pressed{where} (contact: G in Pa s^α)")
        axes.set_xlabel(f"{_axis_name(first)} [mm]")
        axes.set_ylabel(f"{_axis_name(second)} [mm]")
        # Room for the labels, also where all places are one.
        room = 0.15 * max(np.ptp(x), np.ptp(y)) + 2.0
        axes.set_xlim(x.min() - room, x.max() + room)
        axes.set_ylim(y.min() - room, y.max() + 1.5 * room)
        axes.set_aspect("equal")

    return draw(plot, (10.8, 4.2))


def _lateral_axes(approach: Sequence[float]) -> tuple[Array, Array]:
    axis = np.array(unit_vector(approach))
    # The axes of the frame that are least along the approach, made perpendicular to it.
    order = np.argsort(np.abs(axis), kind="stable")
    first = np.eye(3)[min(order[0], order[1])]
    first = first - (first @ axis) * axis
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    if second[int(np.argmax(np.abs(second)))] < 0.0:
        second = -second
    return first, second


def _axis_name(axis: Array) -> str:
    index = int(np.argmax(np.abs(axis)))
    return "xyz"[index] if abs(axis[index]) > 0.999 else f"near {'xyz'[index]}"


# One contact


def signals(session: Session, contact: Contact) -> str:
    """Depth and force of a contact, and the force that was predicted."""
    geometry = session.geometry
    states = [state for state in contact.states.items if state.signals is not None]
    time, predicted = predicted_stress(contact)
    depth = np.array(
        [1e3 * geometry.length * geometry.compression(s.signals.strain) for s in states]
    )
    force = np.array([s.signals.stress / geometry.stress_per_force for s in states])

    def plot(figure: Figure) -> None:
        lower, upper = figure.subplots(2, 1, sharex=True, height_ratios=(2, 3))
        seconds = _since(states, states[0].stamp_ns)
        lower.plot(seconds, depth, color=MEASURED)
        lower.set_ylabel("depth [mm]")
        lower.set_title("Depth and force")
        upper.plot(seconds, force, color=MEASURED, label="measured")
        if time.size:
            first = next(s for s in states if s.innovation is not None)
            shifted = time + _since([first], states[0].stamp_ns)
            modelled = predicted / geometry.stress_per_force
            label = "predicted, one step ahead"
            upper.plot(shifted, modelled, color=ESTIMATE, linestyle="--", label=label)
            style.limit_by(upper, force, 0.25)
        upper.set_ylabel("force [N]")
        upper.set_xlabel("time since the touch [s]")
        upper.legend(loc="upper right", ncols=2)
        figure.align_ylabels()

    return draw(plot)


def characteristic(session: Session, contact: Contact, summary: ContactSummary) -> str:
    """Fractional stress against strain, with the fitted law and its band."""
    points = _points(session.geometry, contact, summary)

    def plot(figure: Figure) -> None:
        axes = figure.add_subplot()
        axes.plot(*points.T, ".", color=MEASURED, markersize=3, label="measured")
        estimate = summary.estimate
        if estimate is not None:
            strain = np.linspace(0.0, max(summary.max_strain, 1e-6), 120)
            response, deviation = _law(strain, summary)
            logs = np.log(response + _TINY)
            low, high = (style.exp(logs + sign * 2 * deviation) for sign in (-1.0, 1.0))
            style.band(axes, strain, low, high)
            axes.plot(strain, response, color=ESTIMATE, label="FDEN")
            boundary = math.exp(-estimate.log_nonlinear_stiffness)
            if boundary < summary.max_strain:
                axes.axvline(boundary, color=MUTED, linestyle=":", linewidth=1)
                axes.annotate(
                    "1/Gn",
                    (boundary, 0.0),
                    xycoords=("data", "axes fraction"),
                    xytext=(3, 3),
                    textcoords="offset points",
                    color=MUTED,
                    fontsize=8,
                )
        axes.set_title("Fractional stress against strain")
        axes.set_xlabel("strain")
        axes.set_ylabel("f' [Pa s^α]")
        axes.yaxis.set_major_formatter(lambda value, _: written(value, 6))
        style.limit_by(axes, points[:, 1], 0.3)
        axes.legend(loc="upper left")

    return draw(plot)


def _points(geometry: Geometry, contact: Contact, summary: ContactSummary) -> Array:
    """Return strains and fractional stresses at the last alpha and origin, shape (n, 2).

    A state has those of its own time: an alpha that was learned later lifts or lowers them.
    """
    estimate, moments = summary.estimate, StressMoments()
    points: list[tuple[float, float]] = []
    before: tuple[int, float] | None = None
    for state in contact.states.items:
        signals = state.signals
        if signals is None:
            continue
        strain, response = signals.strain, signals.fractional_stress
        if before is not None and state.stamp_ns > before[0]:
            step = (state.stamp_ns - before[0]) / NANOSECONDS
            moments.add(step, before[1], signals.stress)
        own = np.append(moments.values, signals.stress)
        if estimate is not None and state.estimate is not None:
            order, then = estimate.fractional_order, state.estimate
            changed = memory_weights(order) - memory_weights(then.fractional_order)
            response += float(changed @ own)
            moved = then.contact_point - estimate.contact_point
            strain = geometry.strain(geometry.compression(strain) + moved)
        points.append((strain, response))
        before = state.stamp_ns, signals.stress
    return np.array(points).reshape(-1, 2)


def _law(strain: Array, summary: ContactSummary) -> tuple[Array, Array]:
    """Return the fitted law over `strain`, and the standard deviation of its logarithm."""
    estimate = summary.estimate
    assert estimate is not None
    stiffness, nonlinear = estimate.linear_stiffness, estimate.nonlinear_stiffness
    response = np.array([elastic_response(x, stiffness, nonlinear).value for x in strain])
    # d ln phi by (ln G, ln Gn).
    gradient = np.array([np.ones_like(strain), np.maximum(nonlinear * strain - 1.0, 0.0)])
    variance = np.einsum("in,ij,jn->n", gradient, estimate.covariance[:2, :2], gradient)
    return response, np.sqrt(np.maximum(variance, 0.0))


def convergence(contact: Contact, truth: dict[str, Any] | None) -> str:
    """How G and Gn became known."""
    states = [s for s in contact.states.items if s.estimate is not None]

    def plot(figure: Figure) -> None:
        time = _since(states, contact.states.items[0].stamp_ns)
        for index, axes in enumerate(figure.subplots(2, 1, sharex=True)):
            key, label = _PARAMETERS[index]
            estimates = [s.estimate for s in states]
            value, low, high = style.parameter(axes, time, estimates, index)
            if truth is not None:
                axes.axhline(truth[key], color=TRUTH, linestyle=":", label="truth")
            final = float(value[-1])
            away = np.abs(np.concatenate([low, high]) - final)
            spread = min(float(np.quantile(away, 0.9)), 2.0 * final)
            axes.set_ylim(final - 1.3 * spread - 0.02 * final, final + 1.3 * spread + 0.02 * final)
            axes.set_ylabel(label)
            axes.yaxis.set_major_formatter(lambda value, _: written(value, 6))
        figure.axes[0].set_title("The estimate")
        style.legend_above(figure.axes[0])
        figure.axes[-1].set_xlabel("time since the touch [s]")
        figure.align_ylabels()

    return draw(plot)


def _seconds(stamp_ns: int, session: Session) -> float:
    return (stamp_ns - session.start_ns) / NANOSECONDS


def _since(states: Sequence[TissueState], start_ns: int) -> Array:
    """Return the times of states since `start_ns` [s], shape (n,)."""
    return np.array([(s.stamp_ns - start_ns) / NANOSECONDS for s in states])


def _envelope(axes: Axes, envelope: Envelope, start_ns: int, scale: float) -> None:
    time, low, high = envelope.arrays(start_ns)
    if time.size:
        # Drawn as a line up and down: where there is one value only, a band has no width.
        y = scale * np.column_stack([low, high]).ravel()
        axes.plot(np.repeat(time, 2), y, color=MEASURED, linewidth=0.9)
