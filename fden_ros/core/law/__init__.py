# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The FDEN law: geometry, characteristic, fractional memory, response at nodes."""
