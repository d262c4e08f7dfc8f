# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Recordings at URLs: a server of S3 and one of the web, on the loopback."""

from __future__ import annotations

import functools
import gzip
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from command_helpers import POSE, ROOT, fden, rows_of
from recording_kinds import bag_of, small

from fden_ros.offline.batch import Results, Work, find_bags, identify
from fden_ros.parameters import check
from fden_ros.recording.reader import BagReader
from fden_ros.recording.source import Selection, open_source
from fden_ros.recording.text import looks_like_a_table

fsspec = pytest.importorskip("fsspec", reason="the extra is not installed")

CONFIG = POSE / "identifier.yaml"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the servers show: a bag, a bag of sqlite3, tables."""
    folder = tmp_path_factory.mktemp("shown")
    shutil.copytree(POSE, folder / "press")
    (folder / "old").mkdir()
    bag_of("sqlite3 file", folder / "old", small()).rename(folder / "old" / "old.db3")
    table = (ROOT / "examples" / "press.csv").read_bytes()
    (folder / "table.csv").write_bytes(table)
    (folder / "packed.csv.gz").write_bytes(gzip.compress(table))
    return folder


@pytest.fixture(scope="module")
def s3(folder: Path) -> Iterator[None]:
    pytest.importorskip("moto", reason="the servers of the tests are not installed")
    import boto3
    from moto.server import DomainDispatcherApplication, create_backend_app
    from werkzeug.serving import make_server

    app = DomainDispatcherApplication(create_backend_app)
    server = make_server("127.0.0.1", 0, app, threaded=True)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{server.port}"
    with pytest.MonkeyPatch.context() as patched:
        for name, value in (
            ("AWS_ENDPOINT_URL", url),
            ("AWS_ACCESS_KEY_ID", "someone"),
            ("AWS_SECRET_ACCESS_KEY", "something"),
            ("AWS_DEFAULT_REGION", "us-east-1"),
        ):
            patched.setenv(name, value)
        client = boto3.client("s3")
        client.create_bucket(Bucket="lab", ACL="public-read")
        for path in folder.rglob("*.*"):
            key = f"day/{path.relative_to(folder)}"
            client.upload_file(str(path), "lab", key, ExtraArgs={"ACL": "public-read"})
        yield
    server.shutdown()


@pytest.fixture(scope="module")
def web(folder: Path) -> Iterator[str]:
    """A server that knows no ranges, as Python has it, with pages of its folders."""
    handler = functools.partial(SimpleHTTPRequestHandler, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture(params=["s3", "web"])
def root(request: pytest.FixtureRequest) -> str:
    """URL of the folder, without a slash."""
    if request.param == "s3":
        request.getfixturevalue("s3")
        return "s3://lab/day"
    return request.getfixturevalue(request.param)


def held(place: str | Path) -> list[Any]:
    """What a recording holds, message by message or row by row."""
    if not looks_like_a_table(place):
        return list(BagReader(place).messages())
    source = open_source(place, check({}), Selection(from_touch=False))
    return [source.inputs, *(column.tolist() for column in source.columns)]


@pytest.mark.parametrize(
    "name", ["press/golden_pose_0.mcap", "old/old.db3", "table.csv", "packed.csv.gz"]
)
def test_a_recording_at_a_url_holds_what_its_file_holds(root, name, folder):
    here = held(folder / name)
    assert here and held(f"{root}/{name}") == here


def test_an_archive_at_a_url_is_identified(web, tmp_path):
    root = web
    names, table = ("press/", "nothing.mcap", "nothing.csv"), tmp_path / "results.csv"
    options = ("-o", table, "--config", CONFIG, "--workers", "1")
    assert fden("batch", *(f"{root}/{name}" for name in names), *options) == 0
    errors = [(row["bag"].removeprefix(root), row["error"]) for row in rows_of(table)]
    (missing, why), (other, why_other), *contacts = sorted(errors)
    assert (missing, other) == ("/nothing.csv", "/nothing.mcap")
    assert "does not exist" in why and "does not exist" in why_other
    assert [error for _, error in contacts] == ["", ""]


def test_recordings_at_urls_are_found_in_folders_and_by_patterns(s3):
    root = "s3://lab/day"
    found = [str(bag).removeprefix(root) for bag in find_bags([root])]
    assert found == ["/old/old.db3", "/packed.csv.gz", "/press", "/table.csv"]
    (bag,) = find_bags([f"{root}/pr*/*.mcap"])
    assert str(bag) == f"{root}/press/golden_pose_0.mcap"


def test_without_the_extra_one_line_says_what_to_install():
    name = "s3://lab/x.mcap"
    hidden = "import sys; sys.modules['upath'] = None; from fden_ros.cli import main; "
    done = subprocess.run(
        [sys.executable, "-c", f"{hidden}sys.exit(main(['replay', {name!r}]))"],
        capture_output=True,
        text=True,
    )
    (line,) = done.stderr.splitlines()
    assert done.returncode == 1 and name in line and "pip install '.[cluster]'" in line


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("http://127.0.0.1:1/press.mcap", "cannot be reached"),
        ("/nowhere/a.mcap", "does not exist"),
    ],
)
def test_what_could_not_be_reached_is_done_again_the_next_time(place, words, tmp_path):
    (row,) = identify(place, work := Work(check({}), Selection()))
    results = Results(tmp_path / "results.csv", work.digest())
    results.add([row])
    assert words in row["error"]
    assert not Results(results.path, work.digest()).has(row["bag"])
