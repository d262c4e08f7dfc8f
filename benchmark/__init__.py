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
    "exact": "tissue that obeys the law: false alarms, undetected errors, coverage, the bound",
    "invariance": "changes that must not move an estimate: noise of 1 nm, shifted stamps, period",
    "real": "prediction of measured holds of beef and silicone",
    "public": "N/m from published recordings, compared with other estimators",
    "laws": "tissue of other laws: how often the next force lies in the predicted interval",
    "robots": "disturbances of a real rig (breathing, compliance, hum): errors, missed contacts",
    "changes": "inclusions and slides under the probe: how soon they are reported; false ones",
    "node": "the node next to a bare relay on real DDS: losses, CPU, latency, memory",
}
