# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whatever the computation raises ends one contact and its site; all else goes on."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fault_helpers import Outcome, assert_sound, outcome_of, shift, shift_recording, undisturbed

from fden_ros.core.contact.detector import ContactDetector
from fden_ros.core.estimation.posterior_estimator import PosteriorEstimator
from fden_ros.core.outputs import Flag, Status
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams.synchronize import Synchronizer
from fden_ros.offline.replay import replay, result_object
from fden_ros.parameters import check, pipeline_config, read_parameter_file
from simulation.bag import write_recording


class BrokenError(Exception):
    """What no code of the package raises or catches."""


def breaks(
    monkeypatch: pytest.MonkeyPatch, kind: type, name: str, when: Callable[[Any], bool]
) -> list[int]:
    """Let a method raise where `when` says so of its object; return a list of its calls."""
    real, calls = getattr(kind, name), []

    def broken(self: Any, *arguments: Any, **named: Any) -> Any:
        calls.append(1)
        if when(self):
            raise BrokenError("on purpose")
        return real(self, *arguments, **named)

    monkeypatch.setattr(kind, name, broken)
    return calls


def of_first_site(after: int = 0) -> Callable[[PosteriorEstimator], bool]:
    """Of the estimator that was called first, from a number of calls on."""
    seen: list[PosteriorEstimator] = []

    def when(estimator: PosteriorEstimator) -> bool:
        seen.append(estimator)
        return estimator is seen[0] and len(seen) > after

    return when


@pytest.fixture
def clean() -> Outcome:
    return undisturbed()


@pytest.mark.parametrize(
    ("name", "after"),
    [("begin_contact", 0), ("take", 9), ("update", 20), ("finish", 0), ("estimate", 40)],
)
def test_an_exception_of_the_estimator_ends_its_contact_and_site_and_no_other(
    monkeypatch: pytest.MonkeyPatch, clean: Outcome, name: str, after: int
) -> None:
    breaks(monkeypatch, PosteriorEstimator, name, of_first_site(after))
    s = shift()
    outcome = outcome_of(s.items, s.parameters)
    assert_sound(outcome.outputs)
    first, *others = outcome.summaries
    assert first.flags & Flag.ESTIMATION_FAILED and not first.complete
    assert first.estimate is None and not first.converged
    assert repr(others) == repr(clean.summaries[1:])
    (failure,) = outcome.pipeline.failures
    assert (failure.site_id, failure.contact_id) == (1, 1)
    assert failure.reason.endswith("BrokenError: on purpose")
    assert "Traceback" in failure.traceback and "in broken" in failure.traceback
    after_it = [x for x in outcome.states if x.site_id == 1 and x.stamp_ns > failure.stamp_ns]
    assert after_it and all(x.estimate is None for x in after_it)
    in_contact = [x for x in after_it if x.status is not Status.NO_CONTACT]
    assert all(x.status is Status.UNKNOWN for x in in_contact)
    assert all(x.flags & Flag.ESTIMATION_FAILED for x in in_contact)


def test_a_failed_site_stays_unusable_until_a_reset(monkeypatch: pytest.MonkeyPatch) -> None:
    breaks(monkeypatch, PosteriorEstimator, "update", of_first_site(20))
    s = shift()
    # All at one place: the second and third contact are of the same site.
    items = [item._replace(position=None) for item in s.items]
    parameters = s.parameters | {"site.timeout": 100.0}
    outcome = outcome_of(items, parameters)
    assert [c.site_id for c in outcome.summaries] == [1, 1, 1]
    assert all(c.flags & Flag.ESTIMATION_FAILED for c in outcome.summaries)
    assert all(c.estimate is None for c in outcome.summaries)
    assert [c.complete for c in outcome.summaries] == [False, True, True]
    assert all(c.max_force > 0.05 and c.sample_count > 100 for c in outcome.summaries[1:])
    assert outcome.pipeline.failure_count == 1 and outcome.pipeline.is_failed

    middle = next(k for k, item in enumerate(items) if s.second(item.stamp_ns) > 7.0)
    steps = [*items[:middle], Pipeline.reset, *items[middle:]]
    monkeypatch.undo()
    breaks(monkeypatch, PosteriorEstimator, "update", of_first_site(20))
    again = outcome_of(steps, parameters)
    assert again.summaries[1].converged and not again.summaries[1].flags
    assert not again.pipeline.is_failed


def test_an_estimate_that_is_not_finite_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    real = PosteriorEstimator.estimate

    def estimate(self: PosteriorEstimator) -> Any:
        found = real(self)
        return found._replace(covariance=found.covariance * np.nan)

    monkeypatch.setattr(PosteriorEstimator, "estimate", estimate)
    s = shift()
    outcome = outcome_of(s.items, s.parameters)
    assert_sound(outcome.outputs)
    assert len(outcome.summaries) == 3 == outcome.pipeline.failure_count
    assert all(c.flags & Flag.ESTIMATION_FAILED for c in outcome.summaries)


@pytest.mark.parametrize("kind", [ContactDetector, Synchronizer])
def test_detector_and_synchronizer_begin_anew_after_an_exception(
    monkeypatch: pytest.MonkeyPatch, kind: type
) -> None:
    calls: list[int] = []
    name = "add" if kind is ContactDetector else "add_force"
    calls = breaks(monkeypatch, kind, name, lambda _: len(calls) == 500)
    s = shift()
    outcome = outcome_of(s.items, s.parameters)
    assert_sound(outcome.outputs)
    assert outcome.pipeline.failure_count == 1
    assert outcome.summaries[-1].converged and outcome.summaries[-1].complete


@pytest.mark.parametrize("finishing", [False, True])
def test_what_a_listener_raises_is_not_caught(finishing: bool) -> None:
    def listen(output: object) -> None:
        if not finishing or done:
            raise BrokenError("the listener's")

    done: list[int] = []
    s = shift()
    pipeline = Pipeline(pipeline_config(check(s.parameters)), listen)
    items = [item for item in s.items if s.second(item.stamp_ns) < 4.0]

    def run() -> None:
        for item in items:
            if item.stream:
                pipeline.add_displacement(item.stamp_ns, item.value, item.position)
            else:
                pipeline.add_force(item.stamp_ns, item.value)
        done.append(1)
        pipeline.finish()

    with pytest.raises(BrokenError, match="the listener's"):
        run()
    assert not pipeline.failures


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("shift") / "bag"
    write_recording(shift_recording(), folder)
    return folder


def test_replay_goes_on_with_the_next_site_warns_and_logs_the_traceback_once(
    bag: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    parameters = read_parameter_file(bag / "identifier.yaml")
    whole = replay(bag, parameters)
    assert whole.failures == () and [c.site_id for c in whole.summaries] == [1, 2, 3]
    breaks(monkeypatch, PosteriorEstimator, "update", of_first_site(20))
    with caplog.at_level(logging.ERROR):
        result = replay(bag, parameters)
    failed = [c for c in result.summaries if c.flags & Flag.ESTIMATION_FAILED]
    assert {c.site_id for c in failed} == {1}
    unharmed = [repr(c) for c in whole.summaries if c.site_id != 1]
    assert [repr(c) for c in result.summaries if c.site_id != 1] == unharmed
    (record,) = (r for r in caplog.records if r.levelno == logging.ERROR)
    assert "Traceback" in record.getMessage() and "on purpose" in record.getMessage()
    (words,) = (w for w in result.warnings if "the estimation failed" in w)
    assert "contact 1 of site 1" in words and "\n" not in words
    contacts = result_object(result)["contacts"]
    assert contacts[0]["flags"] == ["estimation_failed"] and contacts[0]["g"] is None
