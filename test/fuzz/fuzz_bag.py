# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Fuzz what reads recordings: MCAP files, metadata.yaml, messages, tables."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["fden_ros.recording", "fden_ros.offline.replay", "mcap"]):
    from fden_ros.offline.replay import replay
    from fden_ros.recording.reader import BagReader
    from fden_ros.recording.source import Selection
    from fden_ros.recording.table import Columns

from geometry_msgs.msg import WrenchStamped
from harness import fuzz
from sensor_msgs.msg import JointState

from fden_ros.parameters import check
from fden_ros.recording.cdr import serialize
from fden_ros.recording.writer import BagWriter

FOLDER = Path(tempfile.mkdtemp(prefix="fuzz_bag"))
MCAP, METADATA, WRENCH, JOINTS, TABLE = range(5)


def small_bag(folder: Path, force: bytes | None = None, joint: bytes | None = None) -> Path:
    with BagWriter(folder, overwrite=True) as bag:
        bag.add_topic("/force", "geometry_msgs/msg/WrenchStamped")
        bag.add_topic("/joints", "sensor_msgs/msg/JointState")
        for k in range(1, 4):
            wrench, joints = WrenchStamped(), JointState(name=["probe"], position=[0.0])
            wrench.header.stamp.sec = joints.header.stamp.sec = k
            bag.write("/force", serialize(wrench) if force is None else force, k)
            bag.write("/joints", serialize(joints) if joint is None else joint, k)
    return folder


GOOD = small_bag(FOLDER / "good")
GOOD_FILE = next(GOOD.glob("*.mcap"))


def one_input(data: bytes) -> None:
    kind, data = (data[0] % 5, data[1:]) if data else (MCAP, data)
    if kind == MCAP:
        path = FOLDER / "fuzzed.mcap"
        path.write_bytes(data)
    elif kind == METADATA:
        path = FOLDER / "fuzzed"
        path.mkdir(exist_ok=True)
        (path / GOOD_FILE.name).write_bytes(GOOD_FILE.read_bytes())
        (path / "metadata.yaml").write_bytes(data)
    elif kind == TABLE:
        path = FOLDER / "fuzzed.csv"
        path.write_bytes(data)
        columns = Columns.parse("time_s,force_N,depth_mm*1e-3")
        replay(path, check({}), Selection(columns=columns))
        return
    else:
        damaged = {"force": data} if kind == WRENCH else {"joint": data}
        path = small_bag(FOLDER / "damaged", **damaged)
    for _ in BagReader(path).messages():
        pass
    replay(path, check({}))


def seeds() -> dict[str, bytes]:
    wrench, joints = WrenchStamped(), JointState(name=["probe"], position=[0.0])
    return {
        "mcap": bytes([MCAP]) + GOOD_FILE.read_bytes(),
        "metadata": bytes([METADATA]) + (GOOD / "metadata.yaml").read_bytes(),
        "wrench": bytes([WRENCH]) + serialize(wrench),
        "joints": bytes([JOINTS]) + serialize(joints),
        "table": bytes([TABLE]) + b"time_s,force_N,depth_mm\n1,0,0\n1.1,0.1,1\n",
    }


if __name__ == "__main__":
    sys.exit(fuzz(one_input, seeds()))
