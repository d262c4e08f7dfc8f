# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The paper's experiments on anyone's data: dynamic, creep, nonlinearity.

Each module derives its method; :func:`fden_ros.experiments.kinds.fit_file` reads CSV files, as
``fden fit`` does.
"""
