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
