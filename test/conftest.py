# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Every test process has a ROS domain of its own and keeps DDS on this host.

A test marked ``statistics`` shows a statistical claim at its full count of seeds, one marked
``wheels`` installs what is in ``dist``. They run where the expression of ``-m`` names the marker
(``make statistics``, ``make wheel``), and nowhere else.
"""

from __future__ import annotations

import contextlib
import gc
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

import domain_coordinator
import property_helpers
import pytest

from fden_ros.one_thread import one_thread

if TYPE_CHECKING:
    from rclpy.context import Context

property_helpers.load_profile()
_domain = contextlib.ExitStack()
#: Files that take longest are begun first: at the end no process waits long for another.
LONGEST = (
    *("documentation", "live", "benchmark", "node", "configure", "faults", "parameters"),
    *("core_rig", "core_continuous", "cluster", "faults_node"),
    *("core_pipeline_failures", "core_known", "packaging", "commands"),
)


def pytest_configure(config: pytest.Config) -> None:
    # pytest-xdist would begin with the files of most tests.
    config.option.loadscopereorder = False
    # pytest-xdist's workers come here too, each after its own interpreter started.
    os.environ["ROS_DOMAIN_ID"] = str(_domain.enter_context(domain_coordinator.domain_id()))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    places = {f"test_{name}": place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path.stem, len(places)))
    for alone in ("statistics", "wheels"):
        if alone in config.option.markexpr:
            continue
        left_out = [item for item in items if item.get_closest_marker(alone)]
        if left_out:
            config.hook.pytest_deselected(items=left_out)
            items[:] = [item for item in items if item not in left_out]


def pytest_unconfigure(config: pytest.Config) -> None:
    _domain.close()


@pytest.fixture(autouse=True, scope="session")
def on_one_thread() -> Iterator[None]:
    """Run on one thread, as commands and nodes do: with two the estimator is six times slower."""
    with one_thread():
        yield


@pytest.fixture
def context() -> Iterator[Context]:
    """Of nodes in this process, which are gone after the test.

    rclpy frees a lifecycle node's services, and one that could not be made, when it is collected:
    until then others find it by its name.
    """
    import rclpy

    context = rclpy.Context()
    rclpy.init(context=context)
    yield context
    rclpy.try_shutdown(context=context)
    gc.collect()
