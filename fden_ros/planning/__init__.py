# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Which press to make: how deep, how fast, how long, and whether the target can be met at all.

The posterior of a press depends on its data little and on its motion much. So a motion is judged
by the posterior of its own record, simulated for tissues that are drawn from what is known.
"""
