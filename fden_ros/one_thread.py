# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Importing this, before numpy, keeps linear algebra on one thread of the process.

The matrices here are small. Threads would wait for each other, several milliseconds at a time on a
busy machine, and would change the last bits of what a replay must repeat. A number of threads that
is set already stands.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
