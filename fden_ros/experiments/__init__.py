# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The paper's experiments, from tables; `kinds.fit_file` reads one, as ``fden fit`` does."""
