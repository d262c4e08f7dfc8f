# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Units that cannot be, a geometry that is not stated: said everywhere, and never converged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pipeline_helpers import LIVER_PARAMETERS, begun, of_columns, stress_over_g, summaries_of

from benchmark.trial import fed
from fden_ros.control import Cause, LiveTissue
from fden_ros.core.estimation import Prior
from fden_ros.core.outputs import Classification, ContactSummary, Flag, Output, TissueState
from fden_ros.offline.advice import shortfall
from fden_ros.offline.replay import Replay, replay
from fden_ros.parameters import check
from fden_ros.recording.source import Selection
from fden_ros.recording.table import Columns
from fden_ros.ros.status import PipelineProblems
from simulation.simulate import EXACT, KNOWN_RIG

PRESS = Path(__file__).parent.parent / "examples" / "press.csv"
#: 97 mN on 3.14 cm^2: time [s], force [N], depth [mm].
FIRST_PRESS = np.loadtxt(PRESS, delimiter=",", skiprows=1, max_rows=1250)
RIGHT = "time_s,force_N,depth_mm*1e-3"
PROBE = {"geometry.area": 3.14e-4, "geometry.thickness": 0.02}
#: What the data say counts, so that nothing but the flags stands against a good status.
RIGID = {**EXACT, **PROBE, "converged.log_gn_sd": 0.1}


@pytest.fixture(scope="module")
def once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording up to the air after its first press."""
    path = tmp_path_factory.mktemp("once") / "press.csv"
    path.write_text("\n".join(PRESS.read_text(encoding="utf-8").splitlines()[:1250]))
    return path


def identified(
    recording: Path, columns: str, parameters: dict[str, object]
) -> tuple[Replay, list[Output]]:
    outputs: list[Output] = []
    chosen = Selection(columns=Columns.parse(columns))
    found = replay(
        recording, check(parameters), chosen, on_output=lambda output, _: outputs.append(output)
    )
    return found, outputs


WRONG = {
    "mm": ("time_s,force_N,depth_mm*1", RIGID, "mm (factor 0.001: 0.3)"),
    # A hundredfold G is soft tissue too: only a prior of this one tells that the unit is wrong.
    "g": (
        "time_s,force_N*102,depth_mm*1e-3",
        {**RIGID, **LIVER_PARAMETERS},
        "is the force in g (factor 0.00981)",
    ),
    "ms": ("time_s*1e3,force_N,depth_mm*1e-3", RIGID, "is the time in ms (factor 0.001: "),
}


@pytest.mark.parametrize(("columns", "parameters", "words"), WRONG.values(), ids=WRONG)
def test_wrong_unit_is_never_converged_and_said_with_its_factor(columns, parameters, words, once):
    result, outputs = identified(once, columns, parameters)
    assert result.summaries and not result.has_identified
    assert all(summary.flags & Flag.IMPLAUSIBLE for summary in result.summaries)
    assert any(words in warning for warning in result.warnings), result.warnings
    flagged = [o for o in outputs if getattr(o, "flags", Flag.NONE) & Flag.IMPLAUSIBLE]
    estimates = [o.estimate for o in flagged if isinstance(o, TissueState)]
    assert estimates and not any(e.converged for e in estimates if e is not None)
    assert all(o.classes is None for o in flagged if isinstance(o, Classification))


@pytest.mark.parametrize(
    ("force", "displacement", "words"),
    [
        (1.0, 1.0, None),
        (-1.0, 1.0, "below its value in the air; change its sign (force.axis"),
        (1.0, -1.0, "change the sign of the displacement (displacement.axis"),
        (-1.0, -1.0, "the displacement falls with it; change both signs"),
    ],
)
def test_the_stream_of_the_wrong_sign_is_named_from_the_first_word_on(force, displacement, words):
    """As the node looks, once a second, and as a replay says at the end."""
    pipeline, _ = begun(PROBE)
    problems = PipelineProblems(pipeline)
    said: list[tuple[str, ...]] = []
    times, newtons, mm = FIRST_PRESS.T
    for k, _ in enumerate(fed(pipeline, times, force * newtons, displacement * 1e-3 * mm)):
        said += [problems.look().warnings] if k % 200 == 199 else []
    said = [one for one in [*said, tuple(pipeline.warnings)] if one]
    assert all(words is not None and words in likeliest for likeliest, *_ in said), said
    assert bool(said) == (words is not None)


@pytest.mark.parametrize(("seed", "stiffness"), [(0, 483.0), (2, 483.0), (0, 1000.0)])
def test_a_press_whose_both_signs_are_wrong_claims_nothing_live_as_in_a_replay(seed, stiffness):
    """The tissue that pushes less as the probe turns back was seen as a touch of the turn."""
    step, chance = 0.01, np.random.default_rng(seed)
    corners = np.cumsum([0.0, 2.0, 1.62, 2.0, 1.62, 2.0])
    times = np.arange(0.0, corners[-1], step)
    depths = np.interp(times, corners, [-0.003, -0.003, 0.0051, 0.0051, -0.003, -0.003])
    strains = np.maximum(depths, 0.0) / PROBE["geometry.thickness"]
    forces = PROBE["geometry.area"] * stiffness * stress_over_g(strains, step, 9.4, 0.164)
    forces += chance.normal(0.0, 5e-4, times.size)
    depths += chance.normal(0.0, 1e-6, times.size)
    pipeline, outputs = of_columns(PROBE, times, -forces, -depths)
    live = LiveTissue()
    claims = []
    for one in outputs:
        if isinstance(one, TissueState):
            live.add(one, 0.0)
            claims.append(live.stiffness(0.0) or live.reading(0.0))
    summaries = summaries_of(outputs)
    assert summaries and not any(claims)
    assert all(s.flags & Flag.TOUCH_NOT_OBSERVED and s.estimate is None for s in summaries)
    assert "change both signs" in next(iter(pipeline.warnings))


def test_a_sensor_that_drifts_down_between_presses_is_believed(tmp_path):
    times, forces, depths = np.loadtxt(PRESS, delimiter=",", skiprows=1).T
    forces -= 0.05 * np.maximum(times - 5.0, 0.0)
    pipeline, outputs = of_columns(PROBE, times, forces, 1e-3 * depths)
    assert pipeline.is_air_doubted  # the force fell below its value in the air
    assert [s.converged for s in summaries_of(outputs)] == [True, True]
    assert not any(s.flags for s in summaries_of(outputs))
    # And with noise that leaves N/m alone.
    forces += np.random.default_rng(0).normal(0.0, 0.01, times.size)
    noisy = tmp_path / "noisy.csv"
    np.savetxt(noisy, np.transpose([times, forces, depths]), delimiter=",")
    result, _ = identified(noisy, "1,2,3*1e-3", PROBE)
    assert result.is_air_doubted and result.with_stiffness_alone == {1, 2}


def test_slow_recording_is_identified():
    # 2 samples a second; G goes with time^alpha.
    factor = 100
    result, _ = identified(PRESS, f"time_s*{factor},force_N,depth_mm*1e-3", RIGID)
    assert not result.rejected and not result.warnings
    for summary, (g, g_n) in zip(result.summaries, ((450.0, 9.0), (700.0, 8.0)), strict=True):
        assert summary.converged and summary.estimate is not None
        assert summary.estimate.linear_stiffness == pytest.approx(g * factor**0.131, rel=0.02)
        assert summary.estimate.nonlinear_stiffness == pytest.approx(g_n, rel=0.01)


def test_without_a_stated_geometry_nothing_is_converged(once):
    unstated = {**RIGID, **dict.fromkeys(PROBE, 0.0)}
    result, outputs = identified(once, RIGHT, unstated)
    assert "kind: flat_punch, area: " in result.warnings[0]
    # The measured slope needs none.
    assert result.with_stiffness_alone == {s.contact_id for s in result.summaries} != set()
    flagged = [o for o in outputs if isinstance(o, (TissueState, Classification, ContactSummary))]
    assert len(flagged) > 100 and all(o.flags & Flag.GEOMETRY_UNSTATED for o in flagged)
    assert not any(o.estimate.converged for o in outputs if getattr(o, "estimate", None))
    live = LiveTissue()
    state = next(o for o in reversed(outputs) if isinstance(o, TissueState) and o.signals)
    live.add(state, 0.0)
    assert live.refusal(0.0).cause is Cause.REJECTED


# From pN to kN: the same press in other sizes gives the same tissue


def scaled(size: float, stress: float) -> ContactSummary:
    """Return the press with lengths and stresses times factors."""
    parameters = {
        "geometry.area": PROBE["geometry.area"] * size**2,
        "geometry.thickness": PROBE["geometry.thickness"] * size,
        "prior.linear_stiffness": Prior().linear_stiffness * stress,
        "plausibility.max_force": 1e4,
        "force.noise_floor": 1e-16,
        **KNOWN_RIG,
    }
    times, forces, depths = FIRST_PRESS.T
    columns = times, forces * size**2 * stress, 1e-3 * depths * size
    (summary,) = summaries_of(of_columns(parameters, *columns)[1])
    return summary


@pytest.mark.parametrize(("size", "stress"), [(1e-5, 1.0), (5.0, 1e3)], ids=["10 pN", "2 kN"])
def test_a_press_is_the_same_tissue_in_any_size(size: float, stress: float) -> None:
    summary = scaled(size, stress)
    estimate, slope = summary.estimate, summary.measured.loading
    assert estimate is not None and slope is not None
    assert summary.converged and not summary.flags
    # The example's truth is 450 and 9; the slope is that of the press itself, in its units.
    assert estimate.linear_stiffness / stress == pytest.approx(448.0, rel=0.02)
    assert estimate.nonlinear_stiffness == pytest.approx(9.0, rel=0.02)
    assert slope.value / (size * stress) == pytest.approx(43.0, rel=0.04)


@pytest.mark.parametrize("late", [0.03, 0.05])
def test_of_a_press_that_a_delay_spoils_the_remedy_names_the_delay(late):
    """A press of the same place again took a delay of 30 ms for softer tissue."""
    times, forces, mm = FIRST_PRESS.T
    depths = 1e-3 * np.interp(times - late, times, mm)
    pipeline, outputs = of_columns(PROBE, times, forces, depths)
    (summary,) = summaries_of(outputs)
    assert "measure the delay" in shortfall(summary, pipeline.config)
    pipeline, outputs = of_columns({**PROBE, "displacement.delay": late}, times, forces, depths)
    (summary,) = summaries_of(outputs)
    assert summary.converged and not shortfall(summary, pipeline.config)
