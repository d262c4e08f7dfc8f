"""What the documentation says is what the code does."""

from __future__ import annotations

from pathlib import Path

from fden_ros.commands.parameters import parameter_file, parameter_table
from fden_ros.parameters import Parameters, read_parameter_file

ROOT = Path(__file__).parent.parent


def test_the_parameter_file_holds_every_parameter_at_its_default() -> None:
    path = ROOT / "config" / "identifier.yaml"
    assert path.read_text(encoding="utf-8") == parameter_file(), (
        "make it anew: fden parameters > config/identifier.yaml"
    )
    assert read_parameter_file(path) == Parameters()


def test_the_readme_lists_every_parameter() -> None:
    assert parameter_table() in (ROOT / "README.md").read_text(encoding="utf-8"), (
        "put the output of `fden parameters --markdown` into README.md"
    )
