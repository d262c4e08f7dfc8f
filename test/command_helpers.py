# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Commands of ``fden`` in this process."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from fden_ros.cli import main


def fden(*words: object) -> int:
    """Run a command; return its exit code."""
    return main([str(word) for word in words])


def answer(capsys: pytest.CaptureFixture[str], *words: object) -> Any:
    """Run a command that finds something or nothing; return its JSON."""
    capsys.readouterr()
    assert fden(*words, "--json") in (0, 3)
    return json.loads(capsys.readouterr().out)


def rows_of(table: Path) -> list[dict[str, str]]:
    """Return the rows of a table."""
    with table.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def with_values(config: Path, values: Mapping[str, object], name: str = "probe.yaml") -> Path:
    """Write a parameter file with other values beside it; return that."""
    content = yaml.safe_load(config.read_text(encoding="utf-8"))
    (section,) = content.values()
    section["ros__parameters"].update(values)
    other = config.with_name(name)
    other.write_text(yaml.safe_dump(content), encoding="utf-8")
    return other
