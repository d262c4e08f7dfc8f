# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Tables of testing machines, which lack the air before a press."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_helpers import answer
from recording_kinds import NEWTONS

from fden_ros.cli import main
from fden_ros.parameters import check
from fden_ros.recording.source import Selection, open_source

PRESS = Path(__file__).resolve().parents[1] / "examples" / "press.csv"


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


SPECIMEN = "Cylinder Diameter: 50mm;\nCylinder Height: 30mm;\n"


@pytest.mark.parametrize(
    ("preamble", "air", "offset", "is_touched", "is_asked"),
    [
        (SPECIMEN, 0.0, 0.008, True, False),
        (SPECIMEN, 1e-3, 0.0, False, False),
        ("Machine: INSTRON 5900\n", 0.0, 0.0, False, True),
        ("", 0.0, 0.0, False, True),
        ("", 1e-3, 0.0, False, False),
        ("", 0.0, 0.5, False, False),
    ],
)
def test_a_specimen_states_that_a_table_begins_at_the_touch_and_what_looks_so_is_asked_for(
    tmp_path: Path, preamble: str, air: float, offset: float, is_touched: bool, is_asked: bool
) -> None:
    path = tmp_path / "press.csv"
    path.write_text(preamble + NEWTONS + machine_rows(air, offset))
    source = open_source(path, check({}))
    assert (source.parameters.core.contact_point is not None) is is_touched
    assert source.parameters.core.contact.measure_bias is not is_touched
    assert ("then give --from-touch" in " ".join(source.warnings)) is is_asked
    # An option outdoes it, and a configured origin is left alone.
    for from_touch in (False, True):
        stated = open_source(path, check({}), Selection(from_touch=from_touch))
        assert (stated.parameters.core.contact_point is not None) is from_touch
        assert "--from-touch" not in " ".join(stated.warnings)
    parameters = check({"origin.source": "given", "origin.displacement": 1e-3})
    parameters = parameters.changed({"geometry.area": 1e-3, "geometry.thickness": 0.03})
    assert open_source(path, parameters).parameters == parameters


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


def test_options_say_what_a_testing_machine_has_recorded(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "presses.csv"
    rows = machine_rows(steps=300)
    path.write_text(
        "Test," + NEWTONS + "".join(f"{name},{row}\n" for name in "ab" for row in rows.split())
    )
    sizes = ("--diameter", "50mm", "--height", "0.03")
    found = answer(capsys, "replay", path, "--from-touch", *sizes, "--rows", "Test=b")
    assert found["samples"] == 300
    assert found["inputs"]["force"] == "column Load (N)"
    assert "force.measure_bias false" in " ".join(found["set_by_recording"])
    (contact,) = found["contacts"]
    assert not {"touch_not_observed", "geometry_unstated"} & set(contact["flags"])
    assert contact["g"] is not None
    same = answer(
        capsys, "replay", path, "--from-touch", "--area", "1963.4954mm2", "--thickness", "3cm",
        "--rows", "Test=b",
    )  # fmt: skip
    assert same["contacts"][0]["g"] == pytest.approx(contact["g"], rel=1e-6)


@pytest.mark.parametrize(("slope", "curve"), [(400.0, 0.0), (6000.0, 0.0), (400.0, 60.0)])
def test_the_air_of_a_recording_without_air_does_not_drift(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], slope: float, curve: float
) -> None:
    path = tmp_path / "press.csv"
    path.write_text(NEWTONS + machine_rows(offset=0.1, steps=600, slope=slope, curve=curve))
    found = answer(
        capsys, "replay", path, "--no-from-touch", "--diameter", "50mm", "--height", "30mm"
    )
    assert not [line for line in found["warnings"] if "drifts in the air" in line]


@pytest.mark.parametrize(("sign", "code"), [(1.0, 0), (-1.0, 3)])
def test_a_touch_before_the_recording_leaves_the_slope_where_the_signs_are_right(
    sign, code, tmp_path, capsys
):
    rows = np.loadtxt(PRESS, delimiter=",", skiprows=1)
    # From 0.1 s before the first touch to the air after it.
    rows = rows[(rows[:, 0] > 1.83) & (rows[:, 0] < 5.0)] * [1.0, sign, sign]
    path = tmp_path / "press.csv"
    np.savetxt(path, rows, delimiter=",", header="time_s,force_N,depth_mm", comments="")
    command = ["replay", path, "--config", PRESS.with_name("probe.yaml"), "--no-from-touch"]
    assert main([*map(str, command), "--json"]) == code
    (contact,) = json.loads(capsys.readouterr().out)["contacts"]
    assert "touch_not_observed" in contact["flags"]
    # 43 N/m where the touch was observed.
    assert sign < 0.0 or contact["measured_slope"] == pytest.approx(43.0, abs=2.0)
