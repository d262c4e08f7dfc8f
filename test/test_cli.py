# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The shape of ``fden``: every command explains itself, and says in one line what is wrong."""

from __future__ import annotations

import argparse
import importlib

import pytest

from fden_ros.cli import COMMANDS, main
from fden_ros.commands.command import number


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_explains_itself(name, capsys):
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    shown = capsys.readouterr().out
    command = importlib.import_module(f"fden_ros.commands.{name}")
    assert ended.value.code == 0
    assert command.DESCRIPTION in shown and command.EPILOG in shown
    assert command.EPILOG.startswith("examples:\n") and f"fden {name}" in command.EPILOG


@pytest.mark.parametrize("name", COMMANDS)
def test_an_unknown_option_is_one_line_that_names_the_help(name, capsys):
    with pytest.raises(SystemExit) as ended:
        main([name, "--nonsense"])
    (line,) = capsys.readouterr().err.splitlines()
    assert ended.value.code == 2
    assert "error: " in line and line.endswith(" --help")


@pytest.mark.parametrize(
    ("bounds", "good", "bad", "words"),
    [
        ({}, "-1e3", "inf", "expected a number, got 'inf'"),
        ({"above": 0.0}, "1e-9", "0", "a number above 0, got '0'"),
        ({"least": 0.0, "below": 1.0}, "0", "1", "a number of at least 0 and below 1"),
        ({"least": 1, "whole": True}, "1", "1.5", "a whole number of at least 1, got '1.5'"),
        ({"above": 0.0}, "2", "fast", "got 'fast'"),
    ],
)
def test_a_number_is_refused_outside_its_bounds(bounds, good, bad, words):
    convert = number(**bounds)
    assert convert(good) == float(good)
    with pytest.raises(argparse.ArgumentTypeError, match=words):
        convert(bad)
