# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The examples that property tests draw do not depend on what else has run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent
DRAW = """
import sys
sys.path.append(sys.argv[1])
FIRST
import property_helpers
property_helpers.load_profile()
from hypothesis import given, strategies as st

@given(st.integers(), st.floats(), st.lists(st.text()))
def draw(integer, number, texts):
    print(ascii((integer, number, texts)))

draw()
"""
CONSTANTS = "\n".join(
    f"C{k} = {1_000_003 * k}; F{k} = {k}.37; T{k} = 'text {k}'" for k in range(99)
)


def drawn(folder: Path, script: str, **environment: str) -> str:
    (folder / "draw.py").write_text(DRAW.replace("FIRST", script))
    return subprocess.run(
        [sys.executable, "draw.py", str(FOLDER)],
        cwd=folder,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=True,
        timeout=600,
    ).stdout


@pytest.mark.parametrize(
    "script", ["", "import others", "import fden_ros.parameters, pipeline_helpers"]
)
def test_examples_are_the_same_whatever_modules_are_loaded(tmp_path: Path, script: str) -> None:
    (tmp_path / "others.py").write_text(CONSTANTS)
    expected = drawn(tmp_path, "")
    assert len(expected.splitlines()) >= 100
    assert drawn(tmp_path, script) == expected


def test_a_search_draws_new_examples_each_time(tmp_path: Path) -> None:
    first, second = (drawn(tmp_path, "", FDEN_SEARCH="2") for _ in range(2))
    assert first != second
    assert len(first.splitlines()) >= 200
