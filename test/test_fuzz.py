# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Coverage-guided fuzzing of all that reads files, a little (FDEN_FUZZ_SECONDS: longer).

``scripts/fuzz SECONDS`` does it for longer, and keeps what it found.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("atheris", reason="no atheris for this Python")

FOLDER = Path(__file__).parent / "fuzz"
#: By default a fixed number of inputs from a fixed seed; so many seconds each if it is set.
SECONDS = os.environ.get("FDEN_FUZZ_SECONDS")
ROOT = FOLDER.parent.parent
LIMIT = [f"-max_total_time={SECONDS}"] if SECONDS else ["-runs=250", "-seed=1"]


@pytest.mark.parametrize("target", ["bag", "parameters", "library"])
def test_no_input_gets_past_as_anything_but_data_or_one_line(target: str, tmp_path: Path) -> None:
    corpus = tmp_path / "corpus"
    corpus.mkdir()
    done = subprocess.run(
        [
            sys.executable,
            f"fuzz_{target}.py",
            str(corpus),
            *LIMIT,
            "-max_len=20000",
            "-timeout=60",
            f"-artifact_prefix={tmp_path}/",
        ],
        cwd=FOLDER,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=int(SECONDS or "0") + 300,
        check=False,
    )
    said = done.stdout + done.stderr
    assert done.returncode == 0, said[-3000:]
    runs = re.search(r"Done (\d+) runs", said)
    assert runs is not None, said[-3000:]
    assert int(runs[1]) > 10


def test_the_script_leaves_nothing_behind(tmp_path: Path) -> None:
    temporary, here = tmp_path / "temporary", tmp_path / "here"
    temporary.mkdir()
    here.mkdir()
    environment = os.environ | {"TMPDIR": str(temporary)}
    command = [str(ROOT / "scripts" / "fuzz"), "1"]
    subprocess.run(command, cwd=here, env=environment, check=True, capture_output=True)
    assert list(temporary.iterdir()) == list(here.iterdir()) == []
