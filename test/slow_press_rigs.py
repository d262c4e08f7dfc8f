# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings of slow presses by noisy arms, with axes and signs that nobody has configured.

A simulator of its own: a spring that stiffens, behind Maxwell elements, in contact that can only
push.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from fden_ros.configure.streams import Streams

Array = NDArray[np.float64]
_STEP = 5e-3


@dataclass(frozen=True)
class SlowPress:
    """A recording and what is true of it."""

    streams: Streams
    force_axis: Array  #: (3,) or (1,)
    displacement_axis: Array  #: (3,) or (1,)
    peak: float  #: largest change of the contact force [N]
    noise: float  #: of the force per sample [N]
    kind: str


def slow_press(seed: int) -> SlowPress:
    """Draw a rig and its press: from the air, preloaded or from the surface; 0.1 to 1 mm/s."""
    draw = np.random.default_rng([seed, 27])
    kind = str(draw.choice(["air", "preload", "surface"], p=[0.6, 0.25, 0.15]))
    depth = _motion(draw, kind)
    times = _STEP * np.arange(depth.size)
    contact = _tissue_force(draw, depth)
    peak = float(np.exp(draw.uniform(np.log(0.1), np.log(8.0))))
    contact *= peak / np.ptp(contact)
    noise = float(np.exp(draw.uniform(np.log(0.002), np.log(0.1))))
    drift = draw.normal(0.0, 0.003) * times
    into, grows = (_axis(draw) for _ in range(2))
    rate, motion_rate = draw.uniform(60.0, 500.0, 2)
    force_times = np.arange(0.0, times[-1], 1.0 / rate)
    motion_times = np.arange(0.0, times[-1], 1.0 / motion_rate)
    force = np.interp(force_times, times, contact)[:, None] * grows
    force += draw.normal(0.0, 3.0, grows.size)
    force += np.interp(force_times, times, drift)[:, None] * draw.normal(0.0, 1.0, grows.size)
    force += draw.normal(0.0, noise, force.shape)
    late = draw.uniform(0.0, 0.02)
    way = np.interp(motion_times - late, times, depth)[:, None] * into
    way += draw.normal(0.0, 0.3, into.size)
    way += draw.normal(0.0, 1e-5, way.shape)
    streams = Streams("slow press", force_times, force, motion_times, way)
    return SlowPress(streams, grows, into, peak, noise, kind)


def _motion(draw: np.random.Generator, kind: str) -> Array:
    """Return the depth over time [m]; the surface is at 0."""
    speed = 1e-3 * np.exp(draw.uniform(np.log(0.1), 0.0))
    deepest = 1e-3 * draw.uniform(3.0, 8.0)
    start = {"air": -1e-3 * draw.uniform(0.5, 5.0), "surface": 0.0}.get(kind, 0.0)
    if kind == "preload":
        start = draw.uniform(0.05, 0.4) * deepest
    path = [np.full(round(draw.uniform(1.0, 4.0) / _STEP), start)]
    for _ in range(1 if draw.random() < 0.7 else 2):
        path.append(_ramp(path[-1][-1], deepest, speed))
        path.append(np.full(round(draw.choice([0.1, 2.0, 10.0]) / _STEP), deepest))
        retreat = draw.choice(["none", "slow", "fast"], p=[0.2, 0.3, 0.5])
        if retreat == "none":
            break
        fast = 1e-3 * draw.uniform(5.0, 50.0)
        path.append(_ramp(deepest, start, speed if retreat == "slow" else fast))
        path.append(np.full(round(draw.uniform(0.5, 4.0) / _STEP), start))
    return np.concatenate(path)


def _ramp(start: float, end: float, speed: float) -> Array:
    return np.linspace(start, end, max(round(abs(end - start) / speed / _STEP), 2))


def _tissue_force(draw: np.random.Generator, depth: Array) -> Array:
    """Return the force of a press [any unit]; the tissue has long been as deep as at the start."""
    bend = draw.uniform(100.0, 600.0)  # [1/m]: the force of 5 mm is 1.3 to 6 times the linear one
    spring = np.expm1(bend * np.maximum(depth, 0.0))
    steps = np.diff(spring, prepend=spring[0])
    total = draw.uniform(0.2, 0.6) * spring
    weights = draw.dirichlet([1.0, 1.0, 1.0])
    for weight, time in zip(weights, (0.1, 1.0, 10.0), strict=True):
        kept = float(np.exp(-_STEP / time))
        total += weight * lfilter([1.0], [1.0, -kept], steps)
    # Contact can only push.
    return np.asarray(np.maximum(total, 0.0))


def _axis(draw: np.random.Generator) -> Array:
    if draw.random() < 0.5:
        return np.array([draw.choice([-1.0, 1.0])])
    vector = draw.normal(0.0, 1.0, 3)
    return vector / np.linalg.norm(vector)
