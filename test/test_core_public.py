# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The names that the core offers to those outside."""

from __future__ import annotations

import subprocess
import sys

import pytest

import fden_ros.core

NAMES = [
    "Pipeline",
    "PipelineConfig",
    "TissueState",
    "Classification",
    "ContactSummary",
    "DynamicModulus",
    "Decision",
    "Flag",
    "OrderSource",
    "Phase",
    "Status",
]


@pytest.mark.parametrize("name", NAMES)
def test_a_public_name_is_that_of_the_module_it_lives_in(name: str) -> None:
    public = getattr(fden_ros.core, name)
    assert public.__name__ == name and public.__module__.startswith("fden_ros.core.")
    assert name in dir(fden_ros.core) and name in fden_ros.core.__all__


def test_no_other_name_is_offered() -> None:
    assert sorted(NAMES) == fden_ros.core.__all__
    with pytest.raises(AttributeError, match="no attribute 'Nothing'"):
        _ = fden_ros.core.Nothing


def test_importing_the_core_imports_none_of_what_it_computes_with() -> None:
    code = (
        "import sys, fden_ros.core; print(sorted({'numpy', 'scipy', 'rclpy'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout == "[]\n", result.stderr


def test_a_pipeline_of_the_default_estimator_does_not_import_the_papers_filter() -> None:
    code = """
import sys
from fden_ros.core import Pipeline, PipelineConfig
Pipeline(PipelineConfig(None), print)
print(sorted({"filterpy", "scipy.stats", "scipy.optimize"} & set(sys.modules)))
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert result.stdout == "[]\n", result.stderr
