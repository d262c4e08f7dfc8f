# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Samples of two streams in, pairs out: checked, synchronised, the tool's weight taken off."""
