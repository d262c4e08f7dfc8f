# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What an identifier hears, what it lacks, and the one next step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from fden_msgs.msg import TissueEstimate
from lifecycle_msgs.srv import GetState
from rclpy.client import Client
from rclpy.executors import Executor

from fden_ros.nodes.lag import TOO_SLOW, Lags
from fden_ros.nodes.monitor import is_of
from fden_ros.ros.plain_node import plain_node, spin_for

#: Diagnostics come once a second; a problem is sure when it is in two of them [s].
_LISTEN = 3.2
#: An answer is lost where the node has not found the client yet: asked so often, for so long [s].
_ASKED, _ANSWER = 3, 3.0
_ESTIMATE = "fden_msgs/msg/TissueEstimate"
_PROBLEM = "problem "


@dataclass(frozen=True)
class Examination:
    """What was found of one identifier."""

    identifier: str
    state: str = ""  #: of its lifecycle; empty: no such node answers
    words: str = ""  #: of its diagnostics; empty: none came
    values: Mapping[str, str] = field(default_factory=dict)  #: of its diagnostics
    others: tuple[str, ...] = ()  #: identifiers that there are
    lags: Lags = field(default_factory=Lags)  #: of the estimates heard

    @property
    def problems(self) -> list[str]:
        """Return what the node lacks, a sentence each, the first to be mended first."""
        if self.state != "active":
            return [self.words] if self.words else []
        said = [words for key, words in self.values.items() if key.startswith(_PROBLEM)]
        others = [words for words in said if not words.startswith(TOO_SLOW)]
        # The diagnostics are of their last second alone.
        slow = self.lags.problem or next(iter(said[len(others) :]), "")
        return [*others, slow] if slow else others

    @property
    def is_well(self) -> bool:
        """Whether it identifies, as far as it can be seen."""
        return self.state == "active" and bool(self.words) and not self.problems

    @property
    def next_step(self) -> str:
        """Return the one thing to do next."""
        by_hand = f"ros2 lifecycle set {self.identifier}"
        if not self.state:
            if self.others:
                return f"name the one that runs: fden doctor {self.others[0]}"
            return "start it: identifier --ros-args --params-file probe.yaml -p autostart:=true"
        if self.state == "unconfigured":
            mend = "correct what it refused, then " if self.problems else ""
            return f"{mend}{by_hand} configure"
        if self.state == "inactive":
            return f"{by_hand} activate"
        if not self.words:
            return "wait: it is active, but has sent no diagnostics; is the machine overloaded?"
        if self.problems:
            return self.problems[0]
        if self.values.get("contacts") == "0":
            return "lift the probe for 2 s, then press"
        return "nothing: it identifies"

    def page(self) -> str:
        """Return all of it, a line a finding."""
        values = self.values
        lines = [f"{self.identifier}: {self.state or 'does not answer'}"]
        for key, topic in values.items():
            if key.startswith("topic."):
                name = key.removeprefix("topic.")
                rate, lost = values.get(f"received.{name}", "0"), values.get(f"lost.{name}", "0")
                lines.append(f"  hears {name:<13} {topic:<24} {rate:>5} Hz, {lost} lost")
        if "pairs per second" in values:
            rejected = ", ".join(
                f"{key.removeprefix('rejected.')} {count}"
                for key, count in values.items()
                if key.startswith("rejected.")
            )
            lines += [
                f"  makes {'pairs':<13} {'':<24} {values['pairs per second']:>5} Hz",
                f"  saw {values['contacts']} contacts at {values['sites']} sites; "
                f"rejected {values['rejected']} samples" + (f": {rejected}" if rejected else ""),
            ]
        if self.lags.words:
            lines.append(f"  lags {'':<14} {self.lags.words}")
        lines += [f"  lacks: {problem}" for problem in self.problems]
        if self.is_well:
            lines.append("  lacks nothing")
        if "last refusal" in values:
            lines.append(f"  last refusal: {values['last refusal'] or 'none'}")
        return "\n".join([*lines, f"Next: {self.next_step}"])


def examine(identifier: str) -> Examination:
    """Listen to an identifier for some seconds; return what was found.

    Parameters
    ----------
    identifier : str
        Fully qualified name of the node.
    """
    heard: list[DiagnosticArray] = []
    estimates: list[TissueEstimate] = []
    with plain_node("fden_doctor") as (node, executor):
        node.create_subscription(DiagnosticArray, "/diagnostics", heard.append, 100)
        node.create_subscription(TissueEstimate, f"{identifier}/estimate", estimates.append, 100)
        client = node.create_client(GetState, f"{identifier}/get_state")
        spin_for(executor, _LISTEN)
        state = _state(client, executor)
        for _ in range(_ASKED):
            # A busy machine finds the topic late.
            if state != "active" or _statuses(heard, identifier):
                break
            spin_for(executor, _ANSWER)
        others = tuple(
            name.removesuffix("/estimate")
            for name, kinds in sorted(node.get_topic_names_and_types())
            if _ESTIMATE in kinds and name.endswith("/estimate") and node.count_publishers(name)
        )
    own = _statuses(heard, identifier)
    words = own[-1].message if own else ""
    values = {value.key: value.value for value in own[-1].values} if own else {}
    current = [e for e in estimates if e.status != TissueEstimate.STATUS_STALE]
    late = sum(e.status == TissueEstimate.STATUS_LATE for e in current)
    lags = Lags(tuple(e.lag for e in current), late)
    return Examination(identifier, state, words, values, others, lags)


def _statuses(heard: Sequence[DiagnosticArray], identifier: str) -> list[DiagnosticStatus]:
    return [s for message in heard for s in message.status if is_of(s, identifier)]


def _state(client: Client, executor: Executor) -> str:
    """Return the label of the state of a lifecycle node; empty where none answers."""
    for _ in range(_ASKED):
        if not client.service_is_ready():
            return ""
        future = client.call_async(GetState.Request())
        executor.spin_until_future_complete(future, timeout_sec=_ANSWER)
        if future.done():
            return str(future.result().current_state.label)
    return ""
