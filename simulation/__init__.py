# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Simulated recordings: scenarios, exact and stepped contacts, sensors, disturbed rigs.

They are the truth of tests and benchmarks, and the output of ``fden bag``. Like those they are in
the checkout and are not installed. Nothing is shared with :mod:`fden_ros.core`; tissue and rig
in time steps, which the live simulator also needs, are in :mod:`fden_ros.simulation`.
"""
