# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The kinds of recordings that are read, a row each, and those refused with the line's words."""

from __future__ import annotations

import gzip
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

from geometry_msgs.msg import WrenchStamped
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore
from sensor_msgs.msg import JointState
from std_msgs.msg import Header

from fden_ros.recording.bag_files import RawMessage
from fden_ros.recording.message_types import serialize

#: Time [s], force [N] and displacement [m] of the rows that every table holds.
ROWS = [(0.0, 0.0, 0.0), (0.1, 0.25, 0.0005), (0.2, 1234.5, 0.0015), (0.3, 2.75, 0.012)]


class Table(NamedTuple):
    """A table, and what is expected of it."""

    content: str | bytes
    columns: str = ""  #: as with ``--columns``; "": those that the headings state
    file: str = "press.csv"
    refused: tuple[str, ...] = ()  #: words of the one line that says why; none: it is read
    warned: str = ""  #: words of its warning


def lines(form: str, *, time: float = 1.0, force: float = 1.0, displacement: float = 1e3) -> str:
    """Return ROWS, a line each, in units of which so many make one of SI."""
    return "".join(form.format(time * t, force * f, displacement * d) + "\n" for t, f, d in ROWS)


def comma(text: str) -> str:
    return text.replace(".", ",")


PLAIN = lines("{:.3f},{:.4f},{:.4f}")
NEWTONS = "Time (s),Load (N),Depth (mm)\n"
SEMICOLONS = NEWTONS.replace(",", ";")
GERMAN = comma(lines("{:.3f};{:.4f};{:.4f}"))
PREAMBLE = "EF10_A_sample\nCompression test;\nSpeed (mm/min): 10;\nMachine: INSTRON 5900;\n"
POUND, INCH, GRAVITY = 4.4482216152605, 0.0254, 9.80665


def of_units(spelling: str, names: str, time: float, force: float, displacement: float) -> str:
    """Return a table in units, of which so many make one of SI, in brackets or in other ways."""
    made = [f"{word}{spelling}" for word in ("time", "force", "depth")]
    text = ",".join(made).format(*names.split()) if "{" in spelling else "Time,Load,Depth"
    below = "" if "{" in spelling else "\n" + ",".join(f"[{unit}]" for unit in names.split())
    rows = lines("{:.9g},{:.12g},{:.9g}", time=time, force=force, displacement=displacement)
    return f"{text}{below}\n{rows}"


#: Units of time, force and displacement, and how many of each make one of SI.
UNITS = {
    "us mN µm": (1e6, 1e3, 1e6),
    "ms uN nm": (1e3, 1e6, 1e9),
    "min cN cm": (1 / 60, 100.0, 100.0),
    "s kN m": (1.0, 1e-3, 1.0),
    "s gf in": (1.0, 1e3 / GRAVITY, 1 / INCH),
    "sec kgf mm": (1.0, 1 / GRAVITY, 1e3),
    "s lbf um": (1.0, 1 / POUND, 1e6),
}
#: Four times, a tenth of a second apart, as rows have them.
CLOCKS = {
    "times of day": [f"10:15:0{t}" for t, *_ in ROWS],
    "times across midnight": ["23:59:59.9", "00:00:00.0", "00:00:00.1", "00:00:00.2"],
    "dates": [f"2026-03-04 10:15:0{3 + t}" for t, *_ in ROWS],
    "dates of ISO, decimal commas": [f"2026-03-04T9:15:0{comma(str(3 + t))}Z" for t, *_ in ROWS],
}


def clocked(times: list[str]) -> str:
    rows = zip(times, ROWS, strict=True)
    made = "".join(f"{time};{f};{1e3 * d}\n" for time, (_, f, d) in rows)
    return "Time of day;Load (N);Depth (mm)\n" + made


def since(per_second: int, heading: str) -> str:
    """Return a table of times since 1970, in parts of a second: 1000 of ms."""
    begin = 1_700_000_000 * per_second
    rows = ((begin + round(per_second * t), f, 1e3 * d) for t, f, d in ROWS)
    text = "".join(f"{time},{f},{d}\n" for time, f, d in rows)
    return f"{heading},Load (N),Depth (mm)\n{text}"


#: Text of each kind of table that says by itself what is what.
STATED = {
    "headings": NEWTONS + PLAIN,
    "Zwick": "Prüfzeit [s];Standardkraft [N];Standardweg [mm]\n" + GERMAN,
    "German units in words": "Nr;Prüfzeit in s;Standardkraft in N;Verformung in mm\n"
    + comma("".join(f"1;{t};{f};{1e3 * d}\n" for t, f, d in ROWS)),
    "preamble": PREAMBLE + NEWTONS + PLAIN,
    "preamble of cells": '"Operator","Smith"\n"Width","50","mm"\n\n' + NEWTONS + PLAIN,
    "preamble with inches": 'Anvil 2" steel\n' + NEWTONS + PLAIN,
    "Instron": 'Results\n,"Maximum load","Extension at maximum"\n,(N),(mm)\n1,12.3,4.5\n\n'
    + '"Specimen 1"\nTime,Extension,Load\n(s),(mm),(N)\n'
    + "".join(f'"{t}","{1e3 * d}","{f:,.4f}"\n' for t, f, d in ROWS),
    "MTS": "MTS793|BTW|ENU|1|2|.|/|:|1|0|0|A\n\nData Acquisition: Timed\n"
    + "Axial Displacement\tAxial Force\tRunning Time\nmm\tkN\tSec\n"
    + "".join(f"{1e3 * d:.5f}\t{1e-3 * f:.7f}\t{t:.3f}\n" for t, f, d in ROWS),
    "CellScale": "SetName,Cycle,Time_S,Displacement_um,Force_uN\n"
    + "".join(f"press,1-Compress,{t},{1e6 * d:.1f},{1e6 * f:.1f}\n" for t, f, d in ROWS),
    "units row in brackets": PREAMBLE + "Time;Load;Depth\n(s);(N);(mm)\n" + GERMAN,
    "quoted": '"Time (s)","Load, raw (N)","Depth (mm)"\n' + lines('"{:.3f}","{:.4f}","{:.4f}"'),
    "semicolons": SEMICOLONS + PLAIN.replace(",", ";"),
    "tab, decimal commas": NEWTONS.replace(",", "\t") + GERMAN.replace(";", "\t"),
    "blanks, decimal commas": "time_s force_N depth_mm\n" + GERMAN.replace(";", " "),
    "blanks in headings": "Time (s)   Load (N)  Depth (mm)\n" + PLAIN.replace(",", "   "),
    "blanks in headings, one each": " Time [s] Load [N] Depth [mm]\n" + PLAIN.replace(",", " "),
    "commas quoted": NEWTONS + comma(lines('"{:.3f}";"{:.4f}";"{:.4f}"')).replace(";", ","),
    "thousands, points": SEMICOLONS
    + lines("{:.3f};{:,.4f};{:.4f}").translate(str.maketrans(",.", ".,")),
    "comments": "# made by hand\n" + NEWTONS + "# begins\n\n" + PLAIN,
    "trailing commas": NEWTONS.strip() + ",,\n" + PLAIN.replace("\n", ",,\n"),
    "other columns": "No,Load rate (N/s),Time (s),Load (N),Depth (mm),Load cell temperature (C)\n"
    + lines("1,5,{:.3f},{:.4f},{:.4f},21.5"),
    "rows of each topic": "__time,/force/wrench/force/z,/probe/pose/position/z\n"
    + "".join(f"{t},{f},\n{t},,{d}\n" for t, f, d in ROWS),
    "measured beside desired": "time_s,force_cmd_N,force_meas_N,press_desired_mm,press_mm,x_mm\n"
    + "".join(f"{t},9,{f},9,{1e3 * d},9\n" for t, f, d in ROWS),
    "Soll and Ist": "Zeit [s];Sollkraft [N];Istkraft [N];Sollweg [mm];Istweg [mm]\n"
    + comma("".join(f"{t};9;{f};9;{1e3 * d}\n" for t, f, d in ROWS)),
    "ns since 1970": since(10**9, "%time"),
    "ms since 1970": since(1000, "Time"),
    "us since 1970, of a bag's player": since(10**6, "__time"),
    "a long preamble": "".join(f"Parameter {k};value\n" for k in range(500)) + SEMICOLONS + GERMAN,
    "NUL at the end": NEWTONS + PLAIN + 900 * "\0",
}  # fmt: skip

MICRO = "Zeit (s);Kraft (N);Weg (µm)\n" + comma(lines("{:.3f};{:.4f};{:.4f}", displacement=1e6))
STRESSES = comma(lines("{};{};{}", force=1e-3, displacement=1e2))


def asked(headings: str, *words: str) -> Table:
    """Return a table whose headings do not say what is what: the candidates are listed."""
    cells = headings.splitlines()[0].count(",") + 1
    rows = "".join(",".join(f"{k + row}.5" for k in range(cells)) + "\n" for row in range(2))
    return Table(f"{headings}\n{rows}", refused=(*words, "--columns"))


TABLES: dict[str, Table] = {
    **{name: Table(text) for name, text in STATED.items()},
    **{
        f"{names}, {kind}": Table(of_units(spelling, names, *factors))
        for names, factors in UNITS.items()
        for kind, spelling in (("brackets", " ({})"), ("low lines", "_{}"), ("row", ""))
    },
    **{name: Table(clocked(times)) for name, times in CLOCKS.items()},
    **{name: Table(MICRO.encode(name)) for name in ("utf-8-sig", "utf-16", "cp1252")},
    "gzip": Table(gzip.compress(MICRO.encode("utf-16")), file="press.csv.gz"),
    "a name without an ending": Table(MICRO.encode("latin-1"), file="press"),
    # Below the end
    "footer": Table(NEWTONS + PLAIN + "\nend of test\n", warned="ends at line 7 (end of test)"),
    "footer of a clock": Table(
        clocked(CLOCKS["times of day"]) + "Operator;A;B\n", warned="ends at line 6 (Operator, A,"
    ),
    "another table below": Table(
        NEWTONS + PLAIN + "\nTime (s),Depth (mm),Load (N)\n0,1,2\n1,2,3\n",
        warned="3 lines are left out",
    ),
    "results below, with units in a row": Table(
        NEWTONS + PLAIN + "Peak,Height\n(N),(mm)\n12,3,4\n", warned="ends at line 6 (Peak, Height)"
    ),
    "cells that say they are empty": Table(
        NEWTONS + PLAIN + "0.3,NaN,--\n", warned="1 of 5 rows"
    ),
    "commanded alone": Table(
        "time_s,force_N,depth_desired_mm\n" + PLAIN, warned="is commanded, not measured"
    ),
    "magnitude alone": Table(
        "time_s,force_magnitude_N,depth_mm\n" + PLAIN, warned="is a magnitude, as its heading says"
    ),
    "magnitude between bars": Table(
        "time_s,|F| [N],depth_mm\n" + PLAIN,
        "time_s,|F| [N],depth_mm",
        warned="is a magnitude, as its heading says",
    ),
    # Columns that are given, below any preamble
    "names": Table(PREAMBLE + "a,b,c\n" + PLAIN, "a,b,c*1e-3"),
    "numbers": Table(PREAMBLE + NEWTONS + PLAIN, "1,2,3"),
    "numbers of rows alone": Table(GERMAN, "1,2,3*1e-3"),
    "a heading twice": Table(
        "Load (N),Load (N),t,d\n" + lines("9,{1:.4f},{0:.3f},{2:.4f}"), "3,2,4*1e-3"
    ),
    "a heading with a comma": Table(
        't,"Load, raw [N]",Depth\n' + PLAIN, 't,"Load, raw [N]",Depth*1e-3'
    ),
    "rows at a rate": Table("t;f;d\n" + GERMAN, "@10,f,d*1e-3"),
    "stress and strain": Table("Time (s);Stress (kPa);Strain (%)\n" + STRESSES, "1,2,3"),
    # What stays open is asked for, with the columns to write
    "two forces": asked(
        "Time (s),Load A (N),Load B (N),Depth (mm)", "the force: Load A (N), Load B (N)"
    ),
    "the measured without a unit": asked(
        "time_s,force_N,press_actual,x_mm", "'time_s,force_N,press_actual*FACTOR'"
    ),
    "a word without a unit": asked("time_s,force_N,depth,x_mm", "'time_s,force_N,depth*FACTOR'"),
    "a force without a word": asked(
        "Time (s),Pd (µm),Fn (µN)", "such as --columns 'Time (s),Fn (µN)*1e-06,Pd (µm)*1e-06'"
    ),
    "a unit that is not known": asked(
        "time_s,Load (sthene),depth_mm,k", "'time_s,Load (sthene)*FACTOR,depth_mm*0.001'"
    ),
    "whole seconds of what": asked(
        "timestamp,force_N,depth_mm\n1700000000,1,2\n1700020000,1,2", "which column is the time"
    ),
    "dates of another order": Table(
        "Time,force_N,depth_mm\n14/03/2026 09:59:55.1,1,2\n14/03/2026 09:59:55.2,1,2\n",
        refused=("'14/03/2026 09:59:55.1', which is not a number", "--columns '@RATE,force_N,"),
    ),
    "numbers with their units": Table(
        "Time (s),Load (N),Depth (mm)\n0 s,1,2\n1 s,2,3\n",
        refused=("Time (s) holds '0 s', which is not a number", "--columns '@RATE,"),
    ),
    "headings alone": Table(NEWTONS, refused=("has no rows of numbers below Time (s), Load",)),
    "no such column": Table(
        "time,force,depth\n0,1,2\n", "time,force,mm", refused=("no column mm: it has time, f",)
    ),
    # A row that is no row
    "a word in a cell": Table(
        NEWTONS + PLAIN + "0.4,off,3\n0.5,1,3\n", refused=("line 6: '0.4,off,3' has no number",)
    ),
    "a line between rows": Table(
        NEWTONS + PLAIN + "PAUSE\n0.5,1,3\n", refused=("line 6: 'PAUSE' has no number",)
    ),
    "no time": Table(NEWTONS + PLAIN + ",1,3\n", refused=("line 6 has no time",)),
    "another decimal sign later": Table(
        SEMICOLONS + GERMAN + "0.4;1.5;2.25\n0,5;1,5;2,25\n", refused=("line 6: '0.4;1.5;2.25'",)
    ),
    "rows above a line of words": Table(
        NEWTONS + "".join(f"{k},1,2\n" for k in range(12)) + "stop,of,arm\n"
        + "".join(f"{k},1,2\n" for k in range(20, 60)), "1,2,3",
        refused=("12 rows of numbers are above line 14 ('stop,of,arm')",),
    ),
    "rows of one time": Table(
        NEWTONS + 20 * "0,1,2\n" + 20 * "1,1,2\n" + 9 * "2,1,2\n", refused=("such as @20",)
    ),
    "a thousand or a decimal": Table(
        SEMICOLONS + "1;980;1.020\n2;1.020;1.100\n", refused=("'1.020' may have a thousands",)
    ),
    "commas between decimal commas": Table(
        "time_s,force_N,depth_mm\n" + GERMAN.replace(";", ","), refused=("cells by semicolons",)
    ),
    # What is no table
    "gzip without its name": Table(gzip.compress(b"t,f\n"), refused=("name it .csv.gz",)),
    "JSON": Table('{"t": [0, 1]}', refused=("it is JSON: save its columns as CSV",)),
    "a workbook": Table(b"PK\x03\x04\0\0", file="press.xlsx", refused=("sheet as CSV",)),
    "a picture": Table(b"\x89PNG\0\0\0\1\0abc", refused=("it is not a text",)),
    "a broken gzip": Table(
        b"time_s,force_N", file="press.csv.gz", refused=("it is not a complete gzip file",)
    ),
    "nothing": Table("", refused=("is empty",)),
}  # fmt: skip


START = 1_700_000_000_000_000_000
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)

Messages = list[RawMessage]
Make = Callable[[Path, Messages], Path]


def header(time_ns: int) -> Header:
    made = Header(frame_id="probe")
    made.stamp.sec, made.stamp.nanosec = divmod(time_ns, 10**9)
    return made


def small(count: int = 120, stamp: Callable[[int], int] = lambda time_ns: time_ns) -> Messages:
    """Return messages of a force and a joint, each 10 ms apart."""
    made = []
    for k in range(count):
        time_ns = START + k * 10_000_000
        force = WrenchStamped(header=header(stamp(time_ns)))
        force.wrench.force.z = 0.1 * max(0, k - 40)
        joints = JointState(header=header(time_ns), name=["probe"], position=[1e-4 * k])
        for topic, message in (("/force", force), ("/joints", joints)):
            package = type(message).__module__.split(".")[0]
            kind = f"{package}/msg/{type(message).__name__}"
            made.append(RawMessage(topic, kind, time_ns, serialize(message)))
    return made


def filled(
    writer: Ros1Writer | Ros2Writer,
    messages: Messages,
    store: Typestore,
    data_of: Callable[[bytes, str], bytes | memoryview],
) -> None:
    with writer:
        topics: dict[str, Any] = {}
        for topic, kind, time_ns, data in messages:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(topics[topic], time_ns, data_of(data, kind))


def ros2(
    folder: Path,
    messages: Messages,
    mode: CompressionMode = CompressionMode.NONE,
    plugin: StoragePlugin = StoragePlugin.SQLITE3,
) -> Path:
    writer = Ros2Writer(folder, version=8, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    filled(writer, messages, ROS2, lambda data, kind: data)
    return folder


def ros1(
    path: Path, messages: Messages, packing: Ros1Writer.CompressionFormat | None = None
) -> Path:
    writer = Ros1Writer(path)
    if packing is not None:
        writer.set_compression(packing)
    filled(writer, messages, ROS1, ROS2.cdr_to_ros1)
    return path


def alone(folder: Path) -> Path:
    """Return the one file of a bag, in the place of its folder."""
    (file,) = (path for path in folder.iterdir() if path.name != "metadata.yaml")
    moved = Path(shutil.move(file, folder.parent / file.name))
    shutil.rmtree(folder)
    return moved


def broken_metadata(folder: Path) -> Path:
    (folder / "metadata.yaml").write_text("{")
    return folder


def of_foxy(path: Path) -> Path:
    """Return a sqlite3 file with what Foxy wrote alone: no definitions, no hashes."""
    with closing(sqlite3.connect(path)) as database:
        for table in ("schema", "metadata", "message_definitions"):
            database.execute(f"DROP TABLE {table}")
        database.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
    return path


def interrupted(path: Path) -> Path:
    """Return a sqlite3 file as it lies after a power cut: the newest is in its log."""
    folder = path.parent / "cut"
    folder.mkdir()
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("UPDATE messages SET timestamp = timestamp + 1")
        database.commit()
        for suffix in ("", "-wal"):
            shutil.copy(f"{path}{suffix}", folder)
    return folder / path.name


def converted(path: Path, messages: Messages) -> Path:
    """Return a bag of ROS 1 as MCAP, as ``mcap convert`` writes it."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros1")
        channels = {}
        for topic, kind, time_ns, data in messages:
            if topic not in channels:
                text, _ = ROS1.generate_msgdef(kind)
                schema = writer.register_schema(kind.replace("msg/", ""), "ros1msg", text.encode())
                channels[topic] = writer.register_channel(topic, "ros1", schema)
            raw = bytes(ROS2.cdr_to_ros1(data, kind))
            writer.add_message(channels[topic], time_ns, raw, time_ns)
        writer.finish()
    return path


def halves(folder: Path, messages: Messages, write: Callable[[Path, Messages], Path]) -> Path:
    folder.mkdir()
    middle = len(messages) // 2
    for number, part in enumerate((messages[:middle], messages[middle:])):
        write(folder / f"part_{number}", part)
    return folder


def cut(path: Path, part: float) -> Path:
    content = path.read_bytes()
    path.write_bytes(content[: int(part * len(content))])
    return path


def unindexed(path: Path) -> Path:
    """Return a ROS 1 bag as it is while it is recorded: its header points to no index."""
    content = path.read_bytes()
    place = content.index(b"index_pos=") + len(b"index_pos=")
    path.write_bytes(content[:place] + bytes(8) + content[place + 8 :])
    return path


def packed_otherwise(folder: Path) -> Path:
    path = folder / "metadata.yaml"
    path.write_text(path.read_text().replace("zstd", "brotli"))
    return folder


def holding(path: Path, text: str | None) -> Path:
    """Return a file with a text, or an empty folder."""
    if text is None:
        path.mkdir()
    else:
        path.write_text(text)
    return path


class Bag(NamedTuple):
    """What makes a bag of messages, and what is expected of it."""

    make: Make
    warned: str = ""  #: a part of its warning
    refused: str = ""  #: words of the one line that says why; "": it is read


MCAP = StoragePlugin.MCAP
BY_FILE, BY_MESSAGE = CompressionMode.FILE, CompressionMode.MESSAGE
LZ4 = Ros1Writer.CompressionFormat.LZ4
NO_METADATA = "metadata"

BAGS: dict[str, Bag] = {
    "sqlite3": Bag(lambda at, m: ros2(at / "bag", m)),
    "sqlite3 file": Bag(lambda at, m: alone(ros2(at / "bag", m))),
    "sqlite3 split": Bag(
        lambda at, m: halves(at / "bag", m, lambda p, part: alone(ros2(p, part))),
        NO_METADATA,
    ),
    "sqlite3 of Foxy": Bag(lambda at, m: of_foxy(alone(ros2(at / "bag", m)))),
    "sqlite3 by file": Bag(lambda at, m: ros2(at / "bag", m, BY_FILE)),
    "MCAP": Bag(lambda at, m: ros2(at / "bag", m, plugin=MCAP)),
    "MCAP with broken metadata": Bag(
        lambda at, m: broken_metadata(ros2(at / "bag", m, plugin=MCAP)), NO_METADATA
    ),
    "MCAP by message": Bag(lambda at, m: ros2(at / "bag", m, BY_MESSAGE, MCAP)),
    "MCAP of ROS 1": Bag(lambda at, m: converted(at / "old.mcap", m)),
    "ROS 1": Bag(lambda at, m: ros1(at / "old.bag", m)),
    "ROS 1 in lz4": Bag(lambda at, m: ros1(at / "old.bag", m, LZ4)),
    "ROS 1 split": Bag(
        lambda at, m: halves(at / "bag", m, lambda p, part: ros1(p.with_suffix(".bag"), part)),
        NO_METADATA,
    ),
    # What cannot be used
    "sqlite3 interrupted": Bag(
        lambda at, m: interrupted(alone(ros2(at / "bag", m))), refused=".db3-wal was left"
    ),
    "sqlite3 cut off": Bag(
        lambda at, m: cut(alone(ros2(at / "bag", m)), 0.1), refused="is damaged"
    ),
    "sqlite3 of a few bytes": Bag(
        lambda at, m: cut(alone(ros2(at / "a", m)), 1e-4), refused="cut off before"
    ),
    "ROS 1 cut off": Bag(lambda at, m: cut(ros1(at / "a.bag", m), 0.5), refused="is damaged"),
    "ROS 1 not closed": Bag(
        lambda at, m: unindexed(ros1(at / "a.bag", m)), refused="rosbag reindex"
    ),
    "messages in brotli": Bag(
        lambda at, m: packed_otherwise(ros2(at / "bag", m, BY_MESSAGE)), refused="'brotli'"
    ),
    "a file in zstd": Bag(
        lambda at, m: alone(ros2(at / "bag", m, BY_FILE)), refused="compressed with zstd"
    ),
    "nothing there": Bag(lambda at, m: at / "nowhere", refused="does not exist"),
    "a folder without a bag": Bag(
        lambda at, m: holding(at / "folder", None), refused="holds no bag"
    ),
    "an empty MCAP": Bag(lambda at, m: holding(at / "a.mcap", ""), refused="is empty"),
    "a MATLAB file": Bag(
        lambda at, m: holding(at / "a.mat", "MATLAB 5.0 MAT-file, "), refused="it is a MATLAB file"
    ),
    "a text as MCAP": Bag(
        lambda at, m: holding(at / "a.mcap", "time,f\n"), refused="is not a bag"
    ),
}


def bag_of(kind: str, folder: Path, messages: Messages) -> Path:
    """Return messages as a bag of a kind."""
    return BAGS[kind].make(folder, messages)


#: Header stamps of the force by time of recording, and what is said of them.
STAMPS: dict[str, tuple[Callable[[int], int], str]] = {
    "zero": (lambda time_ns: 0, "120 of the first 120 header stamps of /force are 0"),
    "since boot": (lambda time_ns: time_ns - START + 5_000_000_000, "from two clocks?"),
    "whole seconds": (
        lambda time_ns: time_ns // 10**9 * 10**9,
        "only 2 of the first 120 header stamps of /force differ",
    ),
    "ahead": (lambda time_ns: time_ns + 3_000_000_000, "are -3 s before its times of recording"),
}
