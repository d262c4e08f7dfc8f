# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What an oscillation of the probe tells: complex moduli, and stiffness along a path."""
