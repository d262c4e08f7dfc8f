# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables of testing machines and of arms: what they lack of a press in the air, and vectors."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_helpers import answer
from recording_kinds import NEWTONS, PLAIN
from scipy.spatial.transform import Rotation

from fden_ros.core.outputs import ContactSummary
from fden_ros.errors import InputError
from fden_ros.offline.replay import replay
from fden_ros.parameters import check, read_parameter_file
from fden_ros.recording.source import Selection, open_source

POSE = Path(__file__).resolve().parents[1] / "bags" / "golden" / "golden_pose"
PRESS = Path(__file__).resolve().parents[1] / "examples" / "press.csv"


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
    assert (source.parameters.core.contact_point is not None) is is_touched
    assert source.parameters.core.contact.measure_bias is not is_touched
    assert bool(source.set_by_recording) is is_touched
    # An option outdoes what it looks like, and a configured origin is left alone.
    told = open_source(path, check({}), Selection(from_touch=not is_touched))
    assert (told.parameters.core.contact_point is None) is is_touched
    stated = check({"origin.source": "given", "origin.displacement": 1e-3})
    assert open_source(path, stated).parameters == stated


@pytest.mark.parametrize(("back", "is_touched"), [(0.0, True), (-1e-4, False)])
def test_a_probe_that_goes_back_behind_its_first_place_comes_from_the_air(
    tmp_path: Path, back: float, is_touched: bool
) -> None:
    path = tmp_path / "press.csv"
    path.write_text(NEWTONS + machine_rows() + f"41,0.5,1\n42,0,{1e3 * back}\n")
    source = open_source(path, check({}))
    assert (source.parameters.core.contact_point is not None) is is_touched


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


def replayed(capsys: pytest.CaptureFixture[str], *words: object) -> dict[str, Any]:
    result: dict[str, Any] = answer(capsys, "replay", *words)
    return result


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
    assert not {"touch_not_observed", "geometry_unstated"} & set(contact["flags"])
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


@functools.cache
def of_a_joint() -> ContactSummary:
    """Return what the same press gives as two numbers a row."""
    first, _ = replay(PRESS, read_parameter_file(PRESS.with_name("probe.yaml"))).summaries
    return first


@pytest.mark.parametrize(
    ("turns", "force", "has_turns", "said"),
    [
        (UPRIGHT, BASE, True, "displacement.axis [0.0, 0.0, -1.0], force.axis [0.0, 0.0, 1.0]"),
        (UPRIGHT, BASE, False, "displacement.axis [0.0, 0.0, -1.0], force.axis [0.0, 0.0, 1.0]"),
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
    arm = replay(table, read_parameter_file(PRESS.with_name("probe.yaml")))
    usual = of_a_joint()
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
