# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Every test process has a ROS domain of its own and keeps DDS on this host."""

from __future__ import annotations

import contextlib
import os

import domain_coordinator
import property_helpers
import pytest

import fden_ros.one_thread  # noqa: F401 (as in the node: threads change last bits)

property_helpers.load_profile()
_domain = contextlib.ExitStack()


def pytest_configure(config: pytest.Config) -> None:
    # pytest-xdist's workers come here too, each after its own interpreter started.
    os.environ["ROS_DOMAIN_ID"] = str(_domain.enter_context(domain_coordinator.domain_id()))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"


def pytest_unconfigure(config: pytest.Config) -> None:
    _domain.close()
