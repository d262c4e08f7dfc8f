# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Simulated recordings: scenarios, exact and stepped contacts, sensors, rigs that are disturbed.

They are the truth of tests and benchmarks, and what ``fden bag`` writes. Like those they stand in
the checkout and are installed nowhere. Nothing is shared with :mod:`fden_ros.core`; tissue and rig
in time steps, which the live simulator needs too, are in :mod:`fden_ros.simulation`.
"""
