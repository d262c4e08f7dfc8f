# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The states of a contact and of its site, a row a transition."""

from __future__ import annotations

import functools
import itertools
import pickle
from collections.abc import Callable
from typing import Any

import pytest
from fault_helpers import shift
from pipeline_helpers import Item, begun, feed, summaries_of

from fden_ros.core.outputs import ContactSummary, Flag, Output, Phase, Status, TissueState
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.site import Site
from fden_ros.core.site_contact import Contact, Event, State
from fden_ros.core.standing import SiteState
from fden_ros.core.streams import Pair

LATE = {"site.timeout": 0.3}


def new(**own: object) -> tuple[Pipeline, list[Output]]:
    return begun(shift().parameters | own)


def contact_of(pipeline: Pipeline) -> Contact | None:
    return pipeline._session._contact  # type: ignore[union-attr]


def until(pipeline: Pipeline, items: list[Item], when: Callable[[Contact], bool]) -> None:
    """Feed, and take off, the items until a contact is as asked for."""
    while (contact := contact_of(pipeline)) is None or not when(contact):
        feed(pipeline, [items.pop(0)])


@functools.cache
def at(state: State) -> bytes:
    """A pipeline whose contact is at a state, and the items to come."""
    pipeline, _ = new(**{"estimator.kind": "ekf"})
    items = list(shift().items)
    is_forced = state in (State.INTERRUPTED, State.FAILED)
    until(pipeline, items, lambda c: c.state is (State.PRESSING if is_forced else state))
    contact = contact_of(pipeline)
    assert contact is not None
    if state is State.INTERRUPTED:
        list(contact.interrupt(pipeline.newest_ns))
    elif state is State.FAILED:
        contact.site.fail()
        list(contact.fail(pipeline.newest_ns))
    return pickle.dumps((pipeline, items))


STEPS: dict[Event, Callable[[Contact, int], Any]] = {
    Event.RELEASE: Contact.release,
    Event.BREAK: Contact.interrupt,
    Event.SUMMARY: Contact.summarize,
    Event.VERDICT: Contact.judge,
    Event.EXCEPTION: Contact.fail,
}
#: Where each event leads, and whether the summary that comes is complete; None: none comes.
LEADS: dict[tuple[State, Event], tuple[State, bool | None]] = {
    (State.BACKFILL, Event.RELEASE): (State.RELEASED, None),
    (State.BACKFILL, Event.BREAK): (State.INTERRUPTED, False),
    (State.BACKFILL, Event.EXCEPTION): (State.FAILED, False),
    (State.PRESSING, Event.RELEASE): (State.RELEASED, None),
    (State.PRESSING, Event.BREAK): (State.INTERRUPTED, False),
    (State.PRESSING, Event.EXCEPTION): (State.FAILED, False),
    (State.RELEASED, Event.SUMMARY): (State.AIR_CHECK, True),
    # The release has been seen before: no state says any more that it failed.
    (State.RELEASED, Event.EXCEPTION): (State.CLOSED, False),
    (State.AIR_CHECK, Event.VERDICT): (State.CLOSED, None),
    (State.AIR_CHECK, Event.EXCEPTION): (State.CLOSED, None),
    (State.INTERRUPTED, Event.RELEASE): (State.CLOSED, None),
    (State.INTERRUPTED, Event.EXCEPTION): (State.FAILED, None),
    (State.FAILED, Event.RELEASE): (State.CLOSED, None),
    (State.FAILED, Event.EXCEPTION): (State.FAILED, None),
}


@pytest.mark.parametrize(("state", "event"), list(itertools.product(State, STEPS)))
def test_an_event_leads_a_contact_on_or_changes_nothing(state: State, event: Event) -> None:
    pipeline, _ = pickle.loads(at(state))
    contact = contact_of(pipeline)
    outputs = list(STEPS[event](contact, pipeline.newest_ns))
    after, is_complete = LEADS.get((state, event), (state, None))
    assert contact.state is after
    summaries = [o.complete for o in outputs if isinstance(o, ContactSummary)]
    assert summaries == ([] if is_complete is None else [is_complete])
    assert (state, event) in LEADS or not outputs


def test_a_contact_that_has_caught_up_is_pressing():
    pipeline, items = pickle.loads(at(State.BACKFILL))
    until(pipeline, items, lambda contact: contact.state is not State.BACKFILL)
    assert contact_of(pipeline).state is State.PRESSING


def test_a_contact_that_was_interrupted_is_unknown_until_its_release():
    pipeline, items = pickle.loads(at(State.INTERRUPTED))
    outputs: list[Output] = []
    pipeline._emit = outputs.append
    until(pipeline, items, lambda contact: contact.state is not State.INTERRUPTED)
    states = [o for o in outputs if isinstance(o, TissueState) and o.phase is not Phase.APPROACH]
    assert states and {state.status for state in states} == {Status.UNKNOWN}
    assert not any(state.estimate for state in states)


def touch_unseen(site: Site, contact: Contact) -> None:
    site.check_history(contact.onset._replace(seen=False))


def past_unseen(site: Site, contact: Contact) -> None:
    first, *others = contact.onset.samples
    later = first._replace(stamp_ns=first.stamp_ns + 10**9)
    site.check_history(contact.onset._replace(samples=(later, *others), air_seen=False))


def dragged(site: Site, contact: Contact) -> None:
    first = contact.onset.samples[0]
    stamp_ns = site._last_ns + 5_000_000
    aside = (1.0, 1.0, 1.0)
    list(contact.take(Pair(0, stamp_ns, 10.0, first.displacement + 1e-3, aside)))


def long_gap(site: Site, contact: Contact) -> None:
    list(contact.see_gap(site._last_ns, is_long=True))


def exception(site: Site, contact: Contact) -> None:
    site.fail()
    list(contact.fail(site._last_ns))


LOSSES = {
    touch_unseen: (SiteState.UNOBSERVED, Flag.TOUCH_NOT_OBSERVED),
    past_unseen: (SiteState.UNOBSERVED, Flag.TOUCH_NOT_OBSERVED),
    dragged: (SiteState.UNOBSERVED, Flag.TOUCH_NOT_OBSERVED),
    long_gap: (SiteState.UNOBSERVED, Flag.GAP),
    exception: (SiteState.FAILED, Flag.ESTIMATION_FAILED),
}


@pytest.mark.parametrize("loss", LOSSES)
def test_a_site_that_has_lost_its_past_says_nothing_and_never_goes_back(loss) -> None:
    pipeline, _ = pickle.loads(at(State.PRESSING))
    contact = contact_of(pipeline)
    site = contact.site
    assert site.state is SiteState.OBSERVED
    loss(site, contact)
    state, flag = LOSSES[loss]
    assert site.state is state and flag in contact.flags
    assert site.usable_estimate is None
    for later in LOSSES:
        before = site.state
        later(site, contact)
        assert site.state >= before


def test_a_touch_that_may_be_elsewhere_leaves_the_estimator_of_the_last_site_as_it_was():
    pipeline, outputs = new(**LATE)
    items = [item._replace(position=None) for item in shift().items]
    until(pipeline, items, lambda contact: contact.state is State.CLOSED)
    first = contact_of(pipeline).site
    before = pickle.dumps(first._estimator)
    until(pipeline, items, lambda contact: contact.contact_id == 2)
    second = contact_of(pipeline).site
    assert second is not first and len(second._estimator._hypotheses) > 1
    assert pickle.dumps(first._estimator) == before
    assert summaries_of(outputs)[0].converged
