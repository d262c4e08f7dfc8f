# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The command ``fden``: one subcommand per module of :mod:`fden_ros.commands`."""

from __future__ import annotations

import argparse
import importlib
import math
import os
import shlex
import signal
import sys
import textwrap
import time
from collections.abc import Sequence
from types import ModuleType

from fden_ros import __version__
from fden_ros.commands.command import Parser
from fden_ros.commands.options import OPTIONS, add_options
from fden_ros.errors import Hint, InputError, without_ros

#: Two interrupts within this time are one [s].
_SAME_INTERRUPT = 1.0

#: What the exit codes of all commands mean.
EXIT_CODES = {0: "done", 1: "the input cannot be used", 2: "wrong usage", 130: "ended by Ctrl-C"}
_HELP_WIDTH = 79

#: What ``fden --help`` says of each module of :mod:`fden_ros.commands`.
COMMANDS = {
    "configure": "write a parameter file from recordings of an unknown probe",
    "replay": "identify the tissue of a recording",
    "report": "write a page about a recording",
    "monitor": "show the state of a running identifier",
    "live": "run simulator, identifier, controller and monitor together",
    "batch": "identify all recordings of an archive",
    "play": "publish a bag on live topics",
    "parameters": "print and explain every parameter of the identifier",
    "train": "learn a tissue library from labelled contacts",
    "fit": "identify from an experiment with a rheometer or a robot",
    "bag": "simulate a palpation and write it as a bag",
    "benchmark": "measure accuracy and speed, and compare them with their goals",
}

DESCRIPTION = """\
Identify soft tissue from force and displacement with the FDEN model.

  fden configure rec -o probe.yaml     write a parameter file from a recording
  fden replay rec --config probe.yaml  print N/m, G and Gn of each contact
"""


def build_parser() -> argparse.ArgumentParser:
    """Return the parser of ``fden`` with every subcommand."""
    parser = Parser(
        prog="fden", description=DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--version", action="version", version=f"fden {__version__}")
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, summary in COMMANDS.items():
        module = importlib.import_module(f"fden_ros.commands.{name}")
        command = subparsers.add_parser(
            name,
            help=summary,
            description=module.DESCRIPTION,
            epilog=module.EPILOG + _exit_codes(module),
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        add_options(command, OPTIONS.get(name, ()))
        if name == "benchmark":
            module.add_arguments(command)
        command.set_defaults(parser=command, run=module.run)
    return parser


def _exit_codes(module: ModuleType) -> str:
    """Return what the exit codes of a command mean, for its help."""
    meanings = {**EXIT_CODES, **getattr(module, "EXIT_CODES", {})}
    words = "; ".join(f"{code} {meaning}" for code, meaning in sorted(meanings.items()))
    return "\n" + textwrap.fill(f"Exit codes: {words}.", _HELP_WIDTH) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``fden``; return 0 when done, 1 when an input cannot be used, 2 on wrong usage."""
    try:
        parser = build_parser()
        if "_ARGCOMPLETE" in os.environ:
            import argcomplete  # the shell requests completions

            argcomplete.autocomplete(parser)
        given = sys.argv[1:] if arguments is None else arguments
        args, unknown = parser.parse_known_args(given)
        if unknown:
            args.parser.error(f"unrecognized arguments: {shlex.join(unknown)}")
        try:
            return _run(args)
        except InputError as error:
            print(f"fden {args.command}: {error}", file=sys.stderr)
            if error.hint is not None:
                _show(error.hint(), given)
            return 1
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        return 0


def _run(args: argparse.Namespace) -> int:
    try:
        return int(args.run(args))
    except ModuleNotFoundError as error:
        raise without_ros(error) from None


def _show(hint: Hint, arguments: Sequence[str]) -> None:
    for line in hint.lines:
        print(f"  {line}", file=sys.stderr)
    if not hint.options:
        return
    given, words = [], iter(arguments)
    for word in words:
        if word in hint.options and word.startswith("--"):
            next(words, None)
        else:
            given.append(word)
    print(f"try: fden {shlex.join([*given, *hint.options])}", file=sys.stderr)


def program() -> int:
    """Run ``fden`` as a program; Ctrl-C, even if it comes twice, ends it with exit code 130."""
    newest = -math.inf

    def interrupt(number: int, frame: object) -> None:
        nonlocal newest
        # A terminal and a launch file both send it: the second must not interrupt the clean-up
        # after the first.
        before, newest = newest, time.monotonic()
        if newest - before > _SAME_INTERRUPT:
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, interrupt)
    code = main()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return code


if __name__ == "__main__":
    sys.exit(program())
