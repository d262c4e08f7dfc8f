"""Coverage-guided fuzzing of all that reads files, for a short time (FDEN_FUZZ_SECONDS each).

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
SECONDS = int(os.environ.get("FDEN_FUZZ_SECONDS", "10"))


@pytest.mark.parametrize("target", ["bag", "parameters", "library"])
def test_no_input_gets_past_as_anything_but_data_or_one_line(target: str, tmp_path: Path) -> None:
    corpus = tmp_path / "corpus"
    corpus.mkdir()
    done = subprocess.run(
        [
            sys.executable,
            f"fuzz_{target}.py",
            str(corpus),
            f"-max_total_time={SECONDS}",
            "-max_len=20000",
            "-timeout=60",
            f"-artifact_prefix={tmp_path}/",
        ],
        cwd=FOLDER,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=SECONDS + 240,
        check=False,
    )
    said = done.stdout + done.stderr
    assert done.returncode == 0, said[-3000:]
    runs = re.search(r"Done (\d+) runs", said)
    assert runs is not None, said[-3000:]
    assert int(runs[1]) > 10
