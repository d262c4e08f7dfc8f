# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Commands of ``fden``: one module each, whose ``COMMAND`` is what the parser takes."""
