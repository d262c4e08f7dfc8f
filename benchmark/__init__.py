# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Benchmarks: measured figures compared with stated goals, behind ``fden benchmark NAME``.

They are next to the tests and are not installed. A benchmark is a module of this package with
a :class:`benchmark.harness.Benchmark` of the name ``BENCHMARK``, and a line in :data:`BENCHMARKS`.
All have the same parts: *cases*, simulated or recorded data with their truth; a *trial*, the
pipeline on one of them, in a pool of processes (:func:`benchmark.harness.measured`); *scores*
(:mod:`benchmark.score`); *tables*, also printed as the JSON object; and *goals*.
"""

from __future__ import annotations

#: Name of every benchmark, which is that of its module, and its measurement in a line.
BENCHMARKS: dict[str, str] = {
    "exact": "the law's own tissue: false alarms, undetected errors, honesty, the bound",
    "invariance": "what should not move an estimate: noise of 1 nm, shifted stamps, the period",
    "real": "prediction of measured holds of beef and silicone",
    "public": "N/m of recordings of others, next to the estimators of others",
    "laws": "tissue of other laws: does the next force lie in the interval of the prediction",
    "robots": "what a real rig adds: breathing, compliance, hum; errors and contacts missed",
    "changes": "inclusions and slides under the probe: how soon they are reported; false ones",
    "node": "the node next to a bare relay on real DDS: losses, CPU, latency, memory",
}
