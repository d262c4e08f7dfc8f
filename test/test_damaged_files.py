# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whatever stands in a file is read, or refused in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from geometry_msgs.msg import WrenchStamped
from hypothesis import given
from hypothesis import strategies as st
from property_helpers import examples
from sensor_msgs.msg import JointState

from fden_ros.commands.parameters import parameter_file
from fden_ros.errors import InputError
from fden_ros.offline.replay import replay
from fden_ros.parameters import check, pipeline_config, read_parameter_file
from fden_ros.recording.source import Selection
from fden_ros.recording.table import Columns
from fden_ros.recording.writer import BagWriter
from fden_ros.tissues.library import load_library

ROOT = Path(__file__).parent.parent
TABLE = b"time_s,force_N,depth_mm\n1,0,0\n1.1,0.1,1\n1.2,0.2,2\n"

Read = Callable[[Path], object]
#: At a place so many bytes are cut out, and others put in.
damages = st.lists(
    st.tuples(st.integers(0, 10**6), st.integers(0, 20), st.binary(max_size=20)),
    min_size=1,
    max_size=4,
)


def read_table(path: Path) -> object:
    columns = Columns.parse("time_s,force_N,depth_mm*1e-3")
    return replay(path, check({}), Selection(columns=columns))


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Read]]:
    """Good files, each alone in its place, and what reads them."""
    folder = tmp_path_factory.mktemp("good")
    bag = folder / "bag"
    with BagWriter(bag) as writer:
        writer.add_topic("/force", "geometry_msgs/msg/WrenchStamped")
        writer.add_topic("/joints", "sensor_msgs/msg/JointState")
        for k in range(1, 4):
            force, joints = WrenchStamped(), JointState(name=["probe"], position=[0.0])
            force.header.stamp.sec = joints.header.stamp.sec = k
            writer.write("/force", force, k)
            writer.write("/joints", joints, k)
    (folder / "table.csv").write_bytes(TABLE)
    (folder / "probe.yaml").write_text(parameter_file(), encoding="utf-8")
    library = (ROOT / "fden_ros" / "tissues" / "tissues.yaml").read_bytes()
    (folder / "library.yaml").write_bytes(library)
    return {
        "mcap": (bag / "bag_0.mcap", lambda path: replay(path.parent, check({}))),
        "metadata": (bag / "metadata.yaml", lambda path: replay(path.parent, check({}))),
        "table": (folder / "table.csv", read_table),
        "parameters": (
            folder / "probe.yaml",
            lambda path: pipeline_config(read_parameter_file(path)),
        ),
        "library": (folder / "library.yaml", load_library),
    }


@pytest.mark.parametrize("kind", ["mcap", "metadata", "table", "parameters", "library"])
@examples(60)
@given(edits=damages)
def test_a_damaged_file_is_read_or_refused_in_one_line(
    kind: str, files: dict[str, tuple[Path, Read]], edits: list[tuple[int, int, bytes]]
) -> None:
    path, read = files[kind]
    good = content = path.read_bytes()
    for place, count, new in edits:
        place %= len(content) + 1
        content = content[:place] + new + content[place + count :]
    path.write_bytes(content)
    try:
        read(path)
    except InputError as error:
        assert "\n" not in str(error)
    finally:
        path.write_bytes(good)
