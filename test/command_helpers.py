# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Commands of ``fden`` in this process."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rich.console import Console
from sensor_msgs.msg import PointField

from fden_ros.cli import main

ROOT = Path(__file__).resolve().parents[1]
POSE = ROOT / "bags" / "golden" / "golden_pose"


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


def points(cloud: Any) -> dict[str, np.ndarray]:
    """Return the columns of a cloud of points."""
    formats = {PointField.FLOAT32: "<f4", PointField.FLOAT64: "<f8"}
    kind = np.dtype(
        {
            "names": [field.name for field in cloud.fields],
            "formats": [formats[field.datatype] for field in cloud.fields],
            "offsets": [field.offset for field in cloud.fields],
            "itemsize": cloud.point_step,
        }
    )
    rows = np.frombuffer(bytes(cloud.data), kind)
    assert rows.size == cloud.width
    return {name: rows[name] for name in rows.dtype.names or ()}


def text_of(shown: Any, width: int) -> str:
    """Return what a terminal shows, of this number of columns."""
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(shown)
    return console.export_text()
