# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Commands of ``fden``: one module each.

``DESCRIPTION`` and ``EPILOG`` are what ``--help`` says before and after the arguments, the epilog
with examples first; ``EXIT_CODES``, if present, is what its own exit codes mean.
Its arguments are a row of :data:`fden_ros.commands.options.OPTIONS`; ``run`` takes them and
returns the exit code. It calls ``args.parser.error`` if arguments contradict each other, and
raises :class:`~fden_ros.errors.InputError` if something that they name cannot be used.
"""

from fden_ros.one_thread import start_no_threads

start_no_threads()
