# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The one exception that users meet: its text is the single line they read."""


class InputError(Exception):
    """Something given from outside (a file, a parameter, an argument) cannot be used.

    The message is one line that says what is wrong and what would be right. Commands print it and
    exit with 1; the node logs it and refuses the transition.
    """
