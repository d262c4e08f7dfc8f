# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""How property tests draw their examples: always the same ones, or new ones.

``make test`` draws the same examples each time: from a seed that depends on the test's own source
alone, besides those that are given explicitly. Hypothesis would mix in constants of whatever
modules of this project happen to be loaded, and so of the tests that ran before in the same
process; that is turned off. ``make search`` (``FDEN_SEARCH``) draws new ones, that many times as
many, with those constants.
"""

from __future__ import annotations

import os
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

#: By how much the number of examples grows in a search; 0: no search.
SEARCH = int(os.environ.get("FDEN_SEARCH", "0"))


def examples(count: int) -> settings:
    """Return settings for so many examples, more of them in a search."""
    return settings(max_examples=count * max(SEARCH, 1))


def first(*seeds: Any) -> list[Any]:
    """Return the parameters of a test on the first seed in each run, on all by make statistics."""
    return [seeds[0], *(pytest.param(seed, marks=pytest.mark.statistics) for seed in seeds[1:])]


def counts(each_run: int, full: int) -> list[Any]:
    """Return the numbers of seeds in each run, and by make statistics."""
    return [each_run, pytest.param(full, marks=pytest.mark.statistics)]


def load_profile() -> None:
    """Let Hypothesis draw as the module says."""
    settings.register_profile(
        "fden",
        max_examples=100 * max(SEARCH, 1),
        deadline=None,
        derandomize=not SEARCH,
        # Derandomised, Hypothesis keeps no database.
        **({} if SEARCH else {"database": None}),
        print_blob=False,
        suppress_health_check=[HealthCheck.too_slow],
    )
    settings.load_profile("fden")
    if not SEARCH:
        _ignore_local_constants()


def _ignore_local_constants() -> None:
    from hypothesis.internal.conjecture import providers

    # Older versions take no constants from modules and have no such function.
    if hasattr(providers, "is_local_module_file"):
        providers.is_local_module_file = lambda path: False
