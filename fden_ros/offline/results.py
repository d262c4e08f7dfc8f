# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The bag of results: the node's messages, on the recording's own time."""

from __future__ import annotations

from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray

from fden_ros.core.outputs import Output
from fden_ros.core.pipeline import Pipeline
from fden_ros.errors import InputError
from fden_ros.offline.replay import Replay, replay
from fden_ros.parameters import Parameters
from fden_ros.recording.bag_files import RawMessage
from fden_ros.recording.qos import Qos
from fden_ros.recording.source import Selection
from fden_ros.recording.writer import BagWriter
from fden_ros.ros.messages import to_stamp, type_name
from fden_ros.ros.status import PipelineProblems, diagnostic_status
from fden_ros.ros.topics import OUTPUT_TOPICS, OutputMessages

NODE = "/identifier"
DIAGNOSTICS_TOPIC = "/diagnostics"

_DIAGNOSTICS_PERIOD_NS = 1_000_000_000


def replay_to_bag(
    bag: str | Path,
    parameters: Parameters,
    selection: Selection | None,
    folder: str | Path,
    *,
    overwrite: bool = False,
    progress: bool = False,
) -> Replay:
    """Replay a recording and write every output as the node would have published it.

    A message's header stamp is that of the newest sample behind it. Its time of recording is that
    of the input message that caused it: played or shown together, both bags are in step.
    Diagnostics come once a second of recording. The bag appears when it is complete, or not at
    all; `overwrite` replaces an existing one.

    Raises
    ------
    InputError
        As :func:`fden_ros.offline.replay.replay`, or if the bag cannot be written.
    """
    if Path(folder).resolve() == Path(bag).resolve():
        raise InputError(f"{folder} is the recording itself: choose another place for the results")
    with BagWriter(folder, overwrite=overwrite) as writer:
        recorder = _Recorder(writer)
        watched = {"on_output": recorder.take, "on_input": recorder.tick}
        return replay(bag, parameters, selection, progress=progress, **watched)


class _Recorder:
    """Writes outputs at the time of their input."""

    def __init__(self, writer: BagWriter) -> None:
        self._writer = writer
        self._now_ns = 0
        self._next_diagnostics_ns = 0
        self._messages = OutputMessages()
        self._problems: PipelineProblems | None = None
        for topic in OUTPUT_TOPICS:
            qos = Qos.from_profile(topic.qos)
            writer.add_topic(f"{NODE}/{topic.name}", type_name(topic.message_type), qos)
        writer.add_topic(DIAGNOSTICS_TOPIC, type_name(DiagnosticArray), Qos())

    def take(self, output: Output, frame: str) -> None:
        """Write one output of the pipeline."""
        for topic, message in self._messages.of(output, frame):
            self._writer.write(f"{NODE}/{topic.name}", message, self._now_ns)

    def tick(self, log_time_ns: int, message: RawMessage | None, pipeline: Pipeline) -> None:
        """Set the time of the next input, and write diagnostics when they are due."""
        due_ns = self._next_diagnostics_ns or log_time_ns + _DIAGNOSTICS_PERIOD_NS
        while due_ns <= log_time_ns:
            # After a pause one message reports that nothing came; more would repeat it.
            is_late = log_time_ns - due_ns >= 2 * _DIAGNOSTICS_PERIOD_NS
            self._diagnose(due_ns, pipeline)
            due_ns = (log_time_ns if is_late else due_ns) + _DIAGNOSTICS_PERIOD_NS
        self._next_diagnostics_ns = due_ns
        self._now_ns = log_time_ns

    def _diagnose(self, now_ns: int, pipeline: Pipeline) -> None:
        self._problems = self._problems or PipelineProblems(pipeline)
        news = self._problems.look()
        status = diagnostic_status(NODE, news.problems, pipeline, news.pairs)
        message = DiagnosticArray(status=[status])
        message.header.stamp = to_stamp(now_ns)
        self._writer.write(DIAGNOSTICS_TOPIC, message, now_ns)
