# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables as testing machines, instruments and spreadsheets write them are read as they stand."""

from __future__ import annotations

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fden_ros.cli import main
from fden_ros.errors import InputError
from fden_ros.offline.replay import replay
from fden_ros.parameters import check, read_parameter_file
from fden_ros.recording.source import Selection, open_source
from fden_ros.recording.table import Columns, TableReader, stated_columns
from fden_ros.recording.text import looks_like_a_table

POSE = Path(__file__).resolve().parents[1] / "bags" / "golden" / "golden_pose"
PRESS = Path(__file__).resolve().parents[1] / "examples" / "press.csv"

#: Time [s], force [N] and displacement [m] of the rows that every table below holds.
ROWS = [(0.0, 0.0, 0.0), (0.1, 0.25, 0.0005), (0.2, 1234.5, 0.0015), (0.3, 2.75, 0.012)]


def lines(form: str, *, time: float = 1.0, force: float = 1.0, displacement: float = 1e3) -> str:
    """Return ROWS, a line each, in units of which so many make one of SI."""
    return "".join(form.format(time * t, force * f, displacement * d) + "\n" for t, f, d in ROWS)


def comma(text: str) -> str:
    return text.replace(".", ",")


PLAIN = lines("{:.3f},{:.4f},{:.4f}")
NEWTONS = "Time (s),Load (N),Depth (mm)\n"
GERMAN = comma(lines("{:.3f};{:.4f};{:.4f}"))
PREAMBLE = "EF10_A_sample\nCompression test;\nSpeed (mm/min): 10;\nMachine: INSTRON 5900;\n"


def units(names: str, **factors: float) -> str:
    time, force, depth = names.split()
    return f"Time ({time}),Load ({force}),Depth ({depth})\n" + lines(
        "{:.9g},{:.12g},{:.9g}", **factors
    )


POUND, INCH, GRAVITY = 4.4482216152605, 0.0254, 9.80665

#: Text of each kind of table that says by itself what is what.
STATED = {
    "headings": NEWTONS + PLAIN,
    "headings with low lines": "time_s,force_N,depth_mm\n" + PLAIN,
    "headings of a compression": "Time [s],Compression [mm],Load [N]\n"
    + "".join(f"{t:.1f},{1e3 * d:.4f},{f:.4f}\n" for t, f, d in ROWS),
    "German headings": "Prüfzeit [s];Standardkraft [N];Standardweg [mm]\n" + GERMAN,
    "capitals": "TIME(S),LOAD(N),DEPTH(MM)\n" + PLAIN,
    "preamble": PREAMBLE + NEWTONS + PLAIN,
    "preamble of cells": '"Operator","Smith"\n"Width","50","mm"\n\n' + NEWTONS + PLAIN,
    "preamble with inches": 'Anvil 2" steel\n' + NEWTONS + PLAIN,
    "units row": "Time,Load,Depth\ns,N,mm\n" + PLAIN,
    "units row in brackets": PREAMBLE + "Time;Load;Depth\n(s);(N);(mm)\n" + GERMAN,
    "quoted": '"Time (s)","Load, raw (N)","Depth (mm)"\n' + lines('"{:.3f}","{:.4f}","{:.4f}"'),
    "semicolon": NEWTONS.replace(",", ";") + PLAIN.replace(",", ";"),
    "semicolon, decimal commas": NEWTONS.replace(",", ";") + GERMAN,
    "tab": NEWTONS.replace(",", "\t") + PLAIN.replace(",", "\t"),
    "tab, decimal commas": NEWTONS.replace(",", "\t") + GERMAN.replace(";", "\t"),
    "blanks": "time_s force_N depth_mm\n" + PLAIN.replace(",", "   "),
    "blanks, decimal commas": "time_s force_N depth_mm\n" + GERMAN.replace(";", " "),
    "commas quoted": NEWTONS + comma(lines('"{:.3f}";"{:.4f}";"{:.4f}"')).replace(";", ","),
    "commas not quoted": "time_s,force_N,depth_mm\n" + GERMAN.replace(";", ","),
    "thousands, quoted": NEWTONS + lines('{:.3f},"{:,.4f}",{:.4f}'),
    "thousands, points": NEWTONS.replace(",", ";")
    + lines("{:.3f};{:,.4f};{:.4f}").translate(str.maketrans(",.", ".,")),
    "thousands, blanks": NEWTONS.replace(",", ";") + lines("{:.3f};{:_.4f};{:.4f}")
    .replace("_", " ").replace(".", ","),
    "thousands, apostrophes": NEWTONS.replace(",", ";")
    + lines("{:.3f};{:_.4f};{:.4f}").replace("_", "'"),
    "comment": "# made by hand\n" + NEWTONS + "# begins\n" + PLAIN,
    "headings in a comment": "# run 7\n# time_s,force_N,depth_mm\n" + PLAIN,
    "trailing commas": NEWTONS.strip() + ",,\n" + PLAIN.replace("\n", ",,\n"),
    "trailing columns": NEWTONS + PLAIN.replace("\n", ",x,7,end of line\n"),
    "other columns": "No,Load rate (N/s),Time (s),Load (N),Depth (mm),Load cell temperature (C)\n"
    + lines("1,5,{:.3f},{:.4f},{:.4f},21.5"),
    "footer": NEWTONS + PLAIN + "\nend of test\n",
    "sparse": "/clock,/force/wrench/force/z,/probe/pose/position/z\n".replace("/clock", "__time")
    + "".join(f"{t},{f},\n{t},,{d}\n" for t, f, d in ROWS),
    "sparse by instrument": NEWTONS
    + "".join(f"{t},NaN,{1e3 * d}\n{t},{f},NaN\n" for t, f, d in ROWS),
    "blank cells and words": "Time (s),Load (N),Load 2 (N),Depth (mm)\n"
    + lines("{:.3f},{:.4f},off,{:.4f}") + "9,,off,3\n,5,off,3\n",
    "not a number": NEWTONS + PLAIN + "9,NaN,3\n9.1,5,nan\n",
    "robot's recorder": "timestamp actual_TCP_pose_2 actual_TCP_force_2\n"
    + "".join(f"{t} {-d} {f}\n" for t, f, d in ROWS),
    "us mN um": units("us mN µm", time=1e6, force=1e3, displacement=1e6),
    "ms uN nm": units("ms µN nm", time=1e3, force=1e6, displacement=1e9),
    "min cN cm": units("min cN cm", time=1 / 60, force=100.0, displacement=100.0),
    "s kN m": units("s kN m", force=1e-3, displacement=1.0),
    "s gf in": units("s gf in", force=1e3 / GRAVITY, displacement=1 / INCH),
    "s kgf mm": units("s kgf mm", force=1 / GRAVITY),
    "s lbf mm": units("s lbf mm", force=1 / POUND),
    "times of day": "Time,Load (N),Depth (mm)\n" + PLAIN.replace("0.", "23:59:59.", 1).replace(
        "\n0.", "\n23:59:59."
    ),
    "times of day, footer": "Time of day;Load (N);Depth (mm)\n"
    + "".join(f"10:15:0{t};{f};{1e3 * d}\n" for t, f, d in ROWS) + "Operator;A;B\n",
    "clock with thousandths": "Time,Load (N),Depth (mm)\n"
    + "".join(f"10:15:00:{1e3 * t:03.0f},{f},{1e3 * d}\n" for t, f, d in ROWS),
    "echo of a topic": "%time,field.wrench.force.z,field.pose.position.z\n"
    + "".join(f"{1700000000000000000 + int(1e9 * t)},{f},{d}\n" for t, f, d in ROWS),
    "German units in words": "Nr;Prüfzeit in s;Standardkraft in N;Verformung in mm\n"
    + comma("".join(f"1;{t};{f};{1e3 * d}\n" for t, f, d in ROWS)),
    "bars": NEWTONS.replace(",", "|") + PLAIN.replace(",", "|"),
    "results before the rows": ',"Maximum Load","Extension"\n,(N),(mm)\n1,12.3,4.5\n\n'
    + "Time,Load,Extension\n(s),(N),(mm)\n" + PLAIN,
    "measured beside desired": "time_s,force_N,press_desired_mm,press_actual_mm\n"
    + "".join(f"{t},{f},9,{1e3 * d}\n" for t, f, d in ROWS),
    "set and reference": "time_s,force_set_N,force_N,depth_ref_mm,depth_mm\n"
    + "".join(f"{t},9,{f},9,{1e3 * d}\n" for t, f, d in ROWS),
    "Soll and Ist": "Zeit [s];Sollkraft [N];Istkraft [N];Sollweg [mm];Istweg [mm]\n"
    + comma("".join(f"{t};9;{f};9;{1e3 * d}\n" for t, f, d in ROWS)),
    "measured beside another direction": "time_s,force_N,press_desired_mm,press_actual_mm,x_mm\n"
    + "".join(f"{t},{f},9,{1e3 * d},9\n" for t, f, d in ROWS),
    "measured force beside others": "time_s,force_cmd_N,force_meas_N,force_N,depth_mm\n"
    + "".join(f"{t},9,{f},9,{1e3 * d}\n" for t, f, d in ROWS),
    "commanded force": "Time (s),Target load (N),Load (N),Depth (mm)\n"
    + "".join(f"{t},9,{f},{1e3 * d}\n" for t, f, d in ROWS),
}  # fmt: skip


def values(reader: TableReader) -> list[tuple[float, float | None, float | None]]:
    """Return what stands in the rows, times from the first on, sparse rows joined."""
    found: dict[int, list[float | None]] = {}
    for row in reader.rows():
        kept = found.setdefault(row.stamp_ns, [None, None])
        kept[:] = [
            new if new is not None else old for new, old in zip(row[1:3], kept, strict=True)
        ]
    first = min(found)
    return [(1e-9 * (stamp - first), *kept) for stamp, kept in found.items()]  # type: ignore[misc]


def read(path: Path) -> list[tuple[float, float | None, float | None]]:
    return values(TableReader(path, stated_columns(path)))


@pytest.mark.parametrize("kind", STATED)
def test_a_table_that_says_what_is_what_is_read_as_it_stands(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "press.csv"
    path.write_text(STATED[kind], encoding="utf-8")
    assert read(path) == [pytest.approx(row, rel=1e-6, abs=1e-12) for row in ROWS]


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "latin-1", "cp1252"])
@pytest.mark.parametrize("name", ["press.csv", "press.csv.gz", "press"])
def test_encodings_are_told_by_what_the_file_begins_with(
    tmp_path: Path, encoding: str, name: str
) -> None:
    path = tmp_path / name
    content = ("Zeit (s);Kraft (N);Weg (µm)\n" + GERMAN).encode(encoding)
    path.write_bytes(gzip.compress(content) if name.endswith("gz") else content)
    assert looks_like_a_table(path)
    times, forces, depths = zip(*read(path), strict=True)
    assert (times[1], forces[2], depths[3]) == pytest.approx((0.1, 1234.5, 12e-6))


@pytest.mark.parametrize(
    ("first", "second", "seconds"),
    [
        ("2026-03-04 10:15:03.25", "2026-03-04 10:15:04.5", 1.25),
        ("2026-03-04T10:15:03.25Z", "2026-03-04T10:15:03.250000001Z", 1e-9),
        ("04.03.2026 23:59:59,5", "05.03.2026 00:00:01,0", 1.5),
        ("3/4/2026 11:59:59 AM", "3/4/2026 12:00:00 PM", 1.0),
        ("23:59:59.9", "00:00:00.1", 0.2),
        ("01:02.5", "01:03.0", 0.5),
    ],
)
def test_dates_and_times_of_day_are_times(
    tmp_path: Path, first: str, second: str, seconds: float
) -> None:
    path = tmp_path / "press.csv"
    path.write_text(f"Date and time;Load (N);Depth (mm)\n{first};1;2\n{second};3;4\n")
    start, end = TableReader(path, stated_columns(path)).rows()
    assert 1e-9 * (end.stamp_ns - start.stamp_ns) == pytest.approx(seconds, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "columns"),
    [
        (PREAMBLE + "a,b,c\n" + PLAIN, "a,b,c*1e-3"),
        (PREAMBLE + NEWTONS + PLAIN, "Time (s),Load (N),Depth (mm)"),
        (PREAMBLE + NEWTONS + PLAIN, "1,2,3"),
        (PREAMBLE + PLAIN, "1,2,3*1e-3"),
        (GERMAN, "1,2,3*1e-3"),
        (comma(lines("{:.3f}\t{:.5e}\t{:.5e}")), "1,2,3*1e-3"),
        (PREAMBLE + "Load (N),Load (N),t\n" + lines("9,{1:.4f},{0:.3f},{2:.4f}"), "3,2,4*1e-3"),
        ('t,"Load, raw [N]",Depth\n' + PLAIN, 't,"Load, raw [N]",Depth*1e-3'),
        ("t;f;d\n" + GERMAN, "@10,f,d*1e-3"),
        ("Time (s);Stress (kPa);Strain (%)\n"
         + comma(lines("{};{};{}", force=1e-3, displacement=1e2)), "1,2,3"),
    ],
)  # fmt: skip
def test_columns_that_are_given_are_read_below_any_preamble(
    tmp_path: Path, text: str, columns: str
) -> None:
    path = tmp_path / "press.csv"
    path.write_text(text)
    assert values(TableReader(path, Columns.parse(columns))) == [
        pytest.approx(row, rel=1e-6, abs=1e-12) for row in ROWS
    ]


@pytest.mark.parametrize(
    ("headings", "words"),
    [
        ("Time (s),Load A (N),Load B (N),Depth (mm)", "the force: Load A (N), Load B (N)"),
        ("Time (s),Load (N),Load (N),Depth (mm)", "the force: 2, 3"),
        ("Time (s),Load (N),Stroke (mm),Depth (mm)", "the displacement: Stroke (mm), Depth (mm)"),
        (
            "time_s,force_N,press_actual,x_mm",
            "the displacement: press_actual (no unit stated), x_mm; name the columns, such as "
            "--columns 'time_s,force_N,press_actual*0.001'",
        ),
        ("time_s,force_N,depth,x_mm", "the displacement: depth (no unit stated), x_mm"),
        ("time_s,force_desired_N,force,depth_mm", "the force: force (no unit stated), force_des"),
        ("time_s,ft1_force_N,ft2_force_N,z_mm", "the force: ft1_force_N, ft2_force_N"),
        ("Time (s),Load (N),Depth,Width", "which column is the displacement:"),
        ("a,b,c,d", "it has a, b, c, d"),
        ("t,f,z", "do not say"),
        ("time_s,force_N,temperature_K", "do not say"),
    ],
)
def test_what_stays_ambiguous_is_asked_for_with_the_candidates(
    tmp_path: Path, headings: str, words: str
) -> None:
    path = tmp_path / "press.csv"
    path.write_text(f"{headings}\n0.0,1.0,2.0,3.0\n0.1,1.5,2.5,3.5\n")
    with pytest.raises(InputError) as caught:
        stated_columns(path)
    line = str(caught.value)
    assert words in line and "--columns" in line and "\n" not in line


@pytest.mark.parametrize(
    ("headings", "said"),
    [
        ("time_s,force_N,depth_desired_mm", ["column depth_desired_mm is commanded by its head"]),
        ("time_s,force_N,depth_mm", []),
    ],
)
def test_a_column_that_was_only_commanded_is_said_to_be(
    tmp_path: Path, headings: str, said: list[str]
) -> None:
    path = tmp_path / "press.csv"
    path.write_text(f"{headings}\n" + PLAIN)
    source = open_source(path, check({}))
    assert [
        warning[: len(words)] for warning, words in zip(source.warnings, said, strict=True)
    ] == said
    assert source.inputs["displacement"] == f"column {headings.split(',')[2]}"


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("press.csv", b"time_s,force_N,depth_mm\n0,0,5,1\n1,0,5,1,5\n", "decimal commas"),
        ("press.xlsx", b"PK\x03\x04\0\0", "save its sheet as CSV"),
        ("press.csv", b"\x89PNG\0\0\0\1\0abc", "it is no text"),
        ("press.csv.gz", b"time_s,force_N", "it is no complete gzip file"),
        ("press.csv", b"", "is empty"),
    ],
)
def test_a_file_that_cannot_be_read_says_why(
    tmp_path: Path, name: str, content: bytes, words: str
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert looks_like_a_table(path)
    with pytest.raises(InputError, match=words):
        read(path)


# A testing machine's recording


def machine_rows(
    air: float = 0.0,
    offset: float = 0.0,
    steps: int = 400,
    slope: float = 500.0,
    curve: float = 100.0,
) -> str:
    """Return the rows of a press at 0.1 mm/s, 10 Hz and 2 mN of noise.

    After so much air [m] the force [N] has a slope [N/m] that grows exponentially [1/m].
    """
    noise = np.random.default_rng(7).normal(0.0, 2e-3, steps)
    way = 1e-5 * np.arange(steps)
    depth = np.maximum(way - air, 0.0)
    force = offset + slope * depth * np.exp(curve * depth) + noise
    return "".join(
        f"{0.1 * i:.1f},{f:.5f},{1e3 * w:.4f}\n"
        for i, (f, w) in enumerate(zip(force, way, strict=True))
    )


@pytest.mark.parametrize(
    ("air", "offset", "is_touched"),
    [(0.0, 0.0, True), (0.0, 0.008, True), (1e-3, 0.0, False), (0.0, 0.5, False)],
)
def test_a_recording_without_air_is_told_by_its_first_rise(
    tmp_path: Path, air: float, offset: float, is_touched: bool
) -> None:
    path = tmp_path / "press.csv"
    path.write_text(NEWTONS + machine_rows(air, offset))
    source = open_source(path, check({}))
    assert (source.parameters.core.strain_origin is not None) is is_touched
    assert source.parameters.core.contact.measure_bias is not is_touched
    assert bool(source.set_by_recording) is is_touched
    # An option outdoes what it looks like, and a configured origin is left alone.
    told = open_source(path, check({}), Selection(from_touch=not is_touched))
    assert (told.parameters.core.strain_origin is None) is is_touched
    stated = check({"origin.source": "given", "origin.displacement": 1e-3})
    assert open_source(path, stated).parameters == stated


@pytest.mark.parametrize(("back", "is_touched"), [(0.0, True), (-1e-4, False)])
def test_a_probe_that_goes_back_behind_its_first_place_comes_from_the_air(
    tmp_path: Path, back: float, is_touched: bool
) -> None:
    path = tmp_path / "press.csv"
    path.write_text(NEWTONS + machine_rows() + f"41,0.5,1\n42,0,{1e3 * back}\n")
    source = open_source(path, check({}))
    assert (source.parameters.core.strain_origin is not None) is is_touched


@pytest.mark.parametrize(
    ("preamble", "area", "thickness"),
    [
        ("Cylinder Diameter: 50mm;\nCylinder Height: 30mm;\n", 1.963495e-3, 0.03),
        ('"Specimen diameter","50,0","mm"\n"Specimen thickness","0.03","m"\n', 1.963495e-3, 0.03),
        ("Specimen diameter (mm): 80\nIndenter diameter (mm): 10\nThickness (mm): 20\n",
         7.853982e-5, 0.02),
        ("Fläche: 400 mm²\nProbendicke: 12,5 mm\n", 4e-4, 0.0125),
        ("Load cell: 1kN\nDiameter: 50\nSpeed (mm/min): 10\n", 0.0, 0.0),
    ],
)  # fmt: skip
def test_the_specimen_is_taken_from_the_preamble(
    tmp_path: Path, preamble: str, area: float, thickness: float
) -> None:
    path = tmp_path / "press.csv"
    path.write_text(preamble + NEWTONS + machine_rows(), encoding="utf-8")
    geometry = open_source(path, check({})).parameters.geometry
    assert (geometry.area, geometry.thickness) == pytest.approx((area, thickness), rel=1e-5)
    stated = {"geometry.area": 1e-4, "geometry.thickness": 0.01}
    geometry = open_source(path, check(stated)).parameters.geometry
    assert (geometry.area, geometry.thickness) == (1e-4, 0.01)


def replayed(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    main(["replay", *map(str, arguments), "--json"])
    return json.loads(capsys.readouterr().out)  # type: ignore[no-any-return]


def test_options_say_what_a_testing_machine_has_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "presses.csv"
    rows = machine_rows(steps=300)
    path.write_text(
        "Test," + NEWTONS + "".join(f"{name},{row}\n" for name in "ab" for row in rows.split())
    )
    sizes = ("--diameter", "50mm", "--height", "0.03")
    found = replayed(capsys, path, "--from-touch", *sizes, "--rows", "Test=b")
    assert found["samples"] == 300
    assert found["inputs"]["force"] == "column Load (N)"
    assert "force.measure_bias false" in " ".join(found["set_by_recording"])
    (contact,) = found["contacts"]
    assert not {"origin_uncertain", "geometry_unstated"} & set(contact["flags"])
    assert contact["g"] is not None
    same = replayed(
        capsys, path, "--from-touch", "--area", "1963.4954mm2", "--thickness", "3cm",
        "--rows", "Test=b",
    )  # fmt: skip
    assert same["contacts"][0]["g"] == pytest.approx(contact["g"], rel=1e-6)


@pytest.mark.parametrize(("slope", "curve"), [(400.0, 0.0), (6000.0, 0.0), (400.0, 60.0)])
def test_the_air_of_a_recording_without_air_does_not_drift(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], slope: float, curve: float
) -> None:
    path = tmp_path / "press.csv"
    path.write_text(NEWTONS + machine_rows(offset=0.1, steps=600, slope=slope, curve=curve))
    found = replayed(capsys, path, "--no-from-touch", "--diameter", "50mm", "--height", "30mm")
    assert not [line for line in found["warnings"] if "drifts in the air" in line]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--from-touch",), "is no table: --from-touch is for tables"),
        (("--rows", "a=b"), "is no table: --rows is for tables"),
        (("--diameter", "50furlong"), "is no size"),
        (("--area", "-1"), "is no size"),
        (("--diameter", "5mm", "--area", "1mm2"), "not allowed with"),
    ],
)
def test_options_of_tables_that_do_not_fit_are_refused_in_a_line(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], words: str
) -> None:
    try:
        code = main(["replay", str(POSE), *arguments])
    except SystemExit as error:
        code = int(str(error.code))
    line = capsys.readouterr().err
    assert code in (1, 2) and line.count("\n") == 1 and words in line


# An arm's recorder: places and forces are vectors, in the base or in the tool


DOWN = Rotation.from_rotvec([np.pi, 0.0, 0.0])
UPRIGHT = (DOWN,) * 3
ASKEW = (DOWN, DOWN * Rotation.from_euler("x", 20.0, degrees=True), Rotation.identity())
LYING = (Rotation.from_euler("y", 90.0, degrees=True),) * 3
BASE, TOOL = "actual_TCP_force", "ft_raw_wrench"


def arm_table(path: Path, turns: tuple[Rotation, ...], force: str, *, has_turns: bool) -> Path:
    """Write a press at three places 50 mm apart, along the tool's z, as a UR's recorder does."""
    time, load, depth = np.loadtxt(PRESS, delimiter=",", skiprows=1).T
    first = time < 5.6
    parts = []
    for k, turn in enumerate(turns):
        into = turn.apply([0.0, 0.0, 1.0])
        place = 1e-3 * np.outer(depth[first], into) + [0.3, -0.2 + 0.05 * k, 0.1]
        push = np.outer(load[first], -into)
        push = push if force == BASE else turn.inv().apply(push)
        angles = [np.tile(turn.as_rotvec(), (push.shape[0], 1))] if has_turns else []
        parts.append(np.hstack([time[first, None] + 5.6 * k, place, *angles, push]))
    names = [f"actual_TCP_pose_{k}" for k in range(6 if has_turns else 3)]
    names += [f"{force}_{k}" for k in range(3)]
    header = " ".join(["timestamp", *names])
    np.savetxt(path, np.vstack(parts), "%.7f", header=header, comments="")
    return path


@pytest.mark.parametrize(
    ("turns", "force", "has_turns", "said"),
    [
        (UPRIGHT, BASE, True, "displacement.axis [0.0, 0.0, -1.0], force.axis [0.0, 0.0, 1.0]"),
        (UPRIGHT, BASE, False, "displacement.axis [0.0, 0.0, -1.0], force.axis [0.0, 0.0, 1.0]"),
        (UPRIGHT, TOOL, True, "displacement.axis [0.0, 0.0, -1.0], force.axis [0.0, 0.0, -1.0]"),
        (LYING, BASE, True, "displacement.axis [1.0, 0.0, 0.0], force.axis [-1.0, 0.0, 0.0]"),
        (LYING, TOOL, True, "displacement.axis [1.0, 0.0, 0.0], force.axis [0.0, 0.0, -1.0]"),
        (ASKEW, BASE, True, "displacement.along_tool true, force.axis [-0.0, -0.0, -1.0]"),
        (ASKEW, TOOL, True, "displacement.along_tool true, force.axis [-0.0, -0.0, -1.0]"),
    ],
)
def test_three_places_of_an_arm_are_three_sites_whatever_the_frame_of_the_force(
    tmp_path: Path, turns: tuple[Rotation, ...], force: str, has_turns: bool, said: str
) -> None:
    table = arm_table(tmp_path / "robot_data.csv", turns, force, has_turns=has_turns)
    parameters = read_parameter_file(PRESS.with_name("probe.yaml"))
    arm = replay(table, parameters)
    (usual, _) = replay(PRESS, parameters).summaries
    assert [one.site_id for one in arm.summaries] == [1, 2, 3]
    for one in arm.summaries:
        assert one.converged and one.estimate is not None and usual.estimate is not None
        assert one.max_force == pytest.approx(usual.max_force, rel=0.01)
        ratio = one.estimate.linear_stiffness / usual.estimate.linear_stiffness
        assert ratio == pytest.approx(1.0, abs=0.05)
    assert arm.set_by_recording[0].replace("-0.0", "0.0").startswith(said.replace("-0.0", "0.0"))
    frame = "the base's frame" if force == BASE else "the tool's frame"
    assert arm.inputs["force"] == f"columns {force}_0 to {force}_2, in {frame}"


def test_axes_that_are_stated_count_for_an_arm_and_a_machines_options_do_not(
    tmp_path: Path,
) -> None:
    table = arm_table(tmp_path / "robot_data.csv", LYING, BASE, has_turns=True)
    stated = {"displacement.axis": [2.0, 0.0, 0.0], "force.axis": [-1.0, 0.0, 0.0]}
    source = open_source(table, check(stated))
    assert source.set_by_recording == ()
    assert source.parameters == check(stated)
    with pytest.raises(InputError, match="--from-touch is for a machine's one direction"):
        open_source(table, check({}), Selection(from_touch=True))
    placed = arm_table(tmp_path / "places.csv", LYING, BASE, has_turns=False)
    with pytest.raises(InputError, match="asks for the tool's orientation"):
        open_source(placed, check({"displacement.along_tool": True}))
