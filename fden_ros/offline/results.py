# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The bag of results: what the node would have published, on the recording's own time."""

from __future__ import annotations

from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState

from fden_ros.core.outputs import Output
from fden_ros.core.pipeline import Pipeline
from fden_ros.core.streams.rotation import Quaternion
from fden_ros.core.streams.samples import Position, Sink
from fden_ros.errors import InputError
from fden_ros.offline.replay import Replay, replay
from fden_ros.parameters import Parameters, takes_surface
from fden_ros.recording.qos import Qos
from fden_ros.recording.reader import BagReader, RawMessage
from fden_ros.recording.source import Selection, is_table
from fden_ros.recording.writer import BagWriter
from fden_ros.ros.messages import to_stamp
from fden_ros.ros.status import PipelineProblems, diagnostic_status, type_name
from fden_ros.ros.topics import OUTPUT_TOPICS, OutputMessages

NODE = "/identifier"
DIAGNOSTICS_TOPIC = "/diagnostics"
_FORCE_TOPIC, _DISPLACEMENT_TOPIC, _SURFACE_TOPIC = "/force", "/displacement", "/surface"

_DIAGNOSTICS_PERIOD_NS = 1_000_000_000


def replay_to_bag(
    bag: str | Path,
    parameters: Parameters,
    selection: Selection | None,
    folder: str | Path,
    *,
    with_inputs: bool = False,
    overwrite: bool = False,
    progress: bool = False,
) -> Replay:
    """Replay a recording and write every output as the node would have published it.

    A message's header stamp is that of the newest sample behind it, its time of recording that of
    the input message that brought it about: played or shown together, both bags are in step.
    Diagnostics come once a second of recording. The bag appears when it is complete, or not at
    all.

    Parameters
    ----------
    bag, parameters, selection, progress
        As for :func:`fden_ros.offline.replay.replay`.
    folder : path
        The bag to make.
    with_inputs : bool
        Copy the messages on the topics that are used too; the rows of a table become
        joint states on ``/force`` and ``/displacement``, whose replay gives the same numbers.
    overwrite : bool
        Replace a bag that is there.

    Raises
    ------
    InputError
        As :func:`fden_ros.offline.replay.replay`, or if the bag cannot be written.
    """
    if Path(folder).resolve() == Path(bag).resolve():
        raise InputError(f"{folder} is the recording itself: choose another place for the results")
    with BagWriter(folder, overwrite=overwrite) as writer:
        has_rows = is_table(bag, selection)
        rows = _RowCopy(writer, parameters) if with_inputs and has_rows else None
        recorder = _Recorder(writer, _Copy(writer, bag) if with_inputs and not has_rows else None)
        return replay(
            bag,
            parameters,
            selection,
            progress=progress,
            on_output=recorder.take,
            on_input=recorder.tick,
            listener=rows,
        )


class _Copy:
    """Copies messages as they are, each topic declared at its first message."""

    def __init__(self, writer: BagWriter, bag: str | Path) -> None:
        self._writer, self._bag = writer, bag
        self._reader: BagReader | None = None
        self._declared: set[str] = set()

    def take(self, message: RawMessage) -> None:
        if message.topic not in self._declared:
            self._reader = self._reader or BagReader(self._bag)
            topic = self._reader.topic(message.topic)
            self._writer.add_topic(
                topic.name,
                topic.type_name,
                *topic.offered_qos,
                schema=(topic.schema, topic.schema_encoding) if topic.schema else None,
            )
            self._declared.add(message.topic)
        self._writer.write(message.topic, message.data, message.log_time_ns)


class _RowCopy(Sink):
    """Writes the samples of a table as joint states."""

    def __init__(self, writer: BagWriter, parameters: Parameters) -> None:
        self._writer = writer
        # As the table has them: whoever reads the joint states turns their signs as configured.
        self._force_sign = -1.0 if parameters.force.inverted else 1.0
        self._displacement_sign = -1.0 if parameters.displacement.inverted else 1.0
        self._force = JointState(name=[parameters.force.name or "force"])
        self._displacement = JointState(name=[parameters.displacement.name or "displacement"])
        self._surface_scale = parameters.surface.scale or 1.0
        self._surface = JointState(name=[parameters.surface.name or "surface"])
        topics = [_FORCE_TOPIC, _DISPLACEMENT_TOPIC]
        for topic in [*topics, _SURFACE_TOPIC] if takes_surface(parameters) else topics:
            writer.add_topic(topic, type_name(JointState), Qos())

    def add_force(self, stamp_ns: int, force: float) -> None:
        self._force.effort = [self._force_sign * force]
        self._write(_FORCE_TOPIC, self._force, stamp_ns)

    def add_displacement(
        self,
        stamp_ns: int,
        displacement: float,
        position: Position | None = None,
        load: float = 0.0,
        turn: Quaternion | None = None,
    ) -> None:
        self._displacement.position = [self._displacement_sign * displacement]
        self._write(_DISPLACEMENT_TOPIC, self._displacement, stamp_ns)

    def add_surface(self, stamp_ns: int, surface: float) -> None:
        self._surface.position = [surface / self._surface_scale]
        self._write(_SURFACE_TOPIC, self._surface, stamp_ns)

    def _write(self, topic: str, message: JointState, stamp_ns: int) -> None:
        message.header.stamp = to_stamp(stamp_ns)
        self._writer.write(topic, message, stamp_ns)


class _Recorder:
    """Writes outputs at the time of the input that they came from."""

    def __init__(self, writer: BagWriter, copy: _Copy | None) -> None:
        self._writer, self._copy = writer, copy
        self._now_ns = 0
        self._next_diagnostics_ns: int | None = None
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
        """Take note of the time of the next input, and write diagnostics when they are due."""
        if self._next_diagnostics_ns is None:
            self._next_diagnostics_ns = log_time_ns + _DIAGNOSTICS_PERIOD_NS
        while self._next_diagnostics_ns <= log_time_ns:
            # After a pause one message says that nothing came; the rest would say it again.
            late = log_time_ns - self._next_diagnostics_ns >= 2 * _DIAGNOSTICS_PERIOD_NS
            self._diagnose(self._next_diagnostics_ns, pipeline)
            if late:
                self._next_diagnostics_ns = log_time_ns
            self._next_diagnostics_ns += _DIAGNOSTICS_PERIOD_NS
        self._now_ns = log_time_ns
        if self._copy is not None and message is not None:
            self._copy.take(message)

    def _diagnose(self, now_ns: int, pipeline: Pipeline) -> None:
        self._problems = self._problems or PipelineProblems(pipeline)
        news = self._problems.look()
        status = diagnostic_status(NODE, news.problems, pipeline, news.pairs)
        message = DiagnosticArray(status=[status])
        message.header.stamp = to_stamp(now_ns)
        self._writer.write(DIAGNOSTICS_TOPIC, message, now_ns)
