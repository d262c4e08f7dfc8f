# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Search for inputs that break something, with fresh seeds:  make search SEARCH_TIME=SECONDS.

Property tests and fuzzers in turn until the time is over; a round that has begun is finished.
Prints each example that fails once, ready to be pasted above its test. Exit codes: 0 nothing was
found, 1 something was.
"""

from __future__ import annotations

import os
import random
import re
import subprocess
import sys
import textwrap
import time
from pathlib import Path

ROOT = Path(__file__).parent.parent
#: Hypothesis' words for what fails; then the call, of which pytest indents each line.
_FALSIFIED = re.compile(
    r"^E? *(?:Failing test case|Falsifying example|Falsifying explicit example): (\w+)\("
    r"(.*?)^E? *\)$",
    re.MULTILINE | re.DOTALL,
)
#: A round tries this many times the examples of `make test`.
_FACTOR = 4
#: For each of the three fuzzers, in every round of a few minutes [s].
_FUZZ_SECONDS = 20


def examples_of(output: str) -> dict[str, str]:
    """Return the decorators that repeat what failed, and the test of each."""
    found = {}
    for name, call in _FALSIFIED.findall(output):
        lines = [re.sub("^E", " ", line).rstrip() for line in call.splitlines()]
        arguments = textwrap.indent(
            textwrap.dedent("\n".join(line for line in lines if line)), "    "
        )
        arguments = re.sub(r"(?<![\w.])(nan|inf)\b", r"math.\1", arguments)
        found[f"@example(\n{arguments}\n)"] = name
    return found


def run(*arguments: str, **environment: str) -> tuple[int, str]:
    """Run pytest; return its exit code and output."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "--tb=short", *arguments],
        cwd=ROOT,
        env=os.environ | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout


def main(seconds: float) -> int:
    """Search for that long; return the exit code."""
    end = time.monotonic() + seconds
    known: set[str] = set()
    rounds = failed = 0
    while not rounds or time.monotonic() < end:
        rounds += 1
        seed = random.SystemRandom().randrange(2**32)
        code, output = run(
            "-n2", "-mhypothesis", f"--hypothesis-seed={seed}", FDEN_SEARCH=str(_FACTOR)
        )
        fuzz_code, fuzz_output = run("test/test_fuzz.py", FDEN_FUZZ_SECONDS=str(_FUZZ_SECONDS))
        failed += bool(code or fuzz_code)
        for text, name in examples_of(output).items():
            if text not in known:
                known.add(text)
                print(f"\n{name}:\n{text}", flush=True)
        if code and not examples_of(output):
            print(output[-5000:], flush=True)
        if fuzz_code:
            print(fuzz_output[-5000:], flush=True)
        left = max(end - time.monotonic(), 0.0)
        result = output.strip().splitlines()[-1]
        print(f"round {rounds}, seed {seed}: {result}; {left:.0f} s left", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 3600.0))
