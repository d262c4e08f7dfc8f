# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Commands of ``fden``: one module each.

``DESCRIPTION`` and ``EPILOG`` are what ``--help`` says before and after the arguments, the epilog
with examples first, and ``EXIT_CODES``, where it is there, what its own exit codes mean.
Its arguments are a row of :data:`fden_ros.commands.options.OPTIONS`; ``run`` takes them and
returns the exit code. It calls ``args.parser.error`` where arguments do not go together, and
raises :class:`~fden_ros.errors.InputError` where what they name cannot be used.
"""

from fden_ros.one_thread import start_no_threads

start_no_threads()
