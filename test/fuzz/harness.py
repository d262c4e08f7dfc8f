# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What the fuzzers share: start atheris on one target, with a corpus of good inputs.

    python test/fuzz/fuzz_bag.py [CORPUS] [-max_total_time=SECONDS] [options of libFuzzer]

`scripts/fuzz SECONDS` runs them all. A crash leaves its input beside; give the file as the only
argument to run it again.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

from fden_ros.errors import InputError

Target = Callable[[bytes], object]


def refused_or_read(target: Target) -> Target:
    """Return a target for which a refusal in one line is no crash."""

    def one_input(data: bytes) -> None:
        try:
            target(data)
        except InputError as error:
            assert "\n" not in str(error), "a refusal is one line"

    return one_input


def fuzz(target: Target, seeds: dict[str, bytes]) -> None:
    """Write the seeds into the corpus, if there is one, and fuzz."""
    import atheris

    corpus = [Path(argument) for argument in sys.argv[1:] if Path(argument).is_dir()]
    for folder in corpus:
        for name, data in seeds.items():
            (folder / name).write_bytes(data)
    atheris.Setup(sys.argv, refused_or_read(target))
    atheris.Fuzz()
