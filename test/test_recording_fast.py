# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Messages read straight from their bytes are those that their classes decode."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from geometry_msgs.msg import PointStamped, PoseStamped, TransformStamped, WrenchStamped
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState
from tf2_msgs.msg import TFMessage

from fden_ros.parameters import check
from fden_ros.recording.message_types import serialize
from fden_ros.recording.stamps import restamped_data
from fden_ros.ros.decoding import UnusualError, fast_handler
from fden_ros.ros.inputs import Inputs

numbers = st.floats(allow_nan=False)
texts = st.text(st.characters(min_codepoint=1, max_codepoint=0x17F), max_size=9)
vectors = st.tuples(numbers, numbers, numbers)


class Heard:
    """Stands where the pipeline does and writes down what comes."""

    def __init__(self) -> None:
        self.calls: list[tuple[Any, ...]] = []

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: self.calls.append((name, *arguments))


def both_ways(
    what: str, message: Any, type_name: str, joint: str = ""
) -> tuple[list[Any], list[Any] | None]:
    """Return what arrives through the class and from the bytes; None if they are unusual."""
    parameters = check(
        {
            "force.axis": [0.1, -0.7, 0.3],
            "displacement.axis": [0.0, 0.2, -1.0],
            "force.inverted": True,
            "displacement.inverted": True,
            f"{what}.name": joint,
        }
    )
    data = serialize(message)
    slow, quick = Heard(), Heard()
    inputs = Inputs(parameters, slow)  # type: ignore[arg-type]
    inputs.add(what, deserialize_message(data, type(message)))
    handler = fast_handler(what, type_name, Inputs(parameters, quick))  # type: ignore[arg-type]
    assert handler is not None
    try:
        handler(data)
    except (UnusualError, struct.error):
        return slow.calls, None
    return slow.calls, quick.calls


def fill(message: Any, frame: str, seconds: int, nanoseconds: int) -> Any:
    message.header.frame_id = frame
    message.header.stamp.sec, message.header.stamp.nanosec = seconds, nanoseconds
    return message


@pytest.mark.parametrize(
    ("what", "kind", "part"),
    [
        ("force", WrenchStamped, lambda m: m.wrench.force),
        ("displacement", PoseStamped, lambda m: m.pose.position),
        ("displacement", PointStamped, lambda m: m.point),
        ("displacement", TransformStamped, lambda m: m.transform.translation),
    ],
)
@given(frame=texts, child=texts, value=vectors, seconds=st.integers(-(2**31), 2**31 - 1))
def test_vectors_are_the_same_bit_for_bit(what, kind, part, frame, child, value, seconds):
    message = fill(kind(), frame, seconds, 999_999_999)
    if kind is TransformStamped:
        message.child_frame_id = child
    target = part(message)
    target.x, target.y, target.z = value
    slow, quick = both_ways(what, message, f"geometry_msgs/msg/{kind.__name__}")
    if not frame.isascii():
        assert quick is None
    else:
        assert repr(quick) == repr(slow)


@given(
    what=st.sampled_from(["force", "displacement"]),
    names=st.lists(texts, max_size=5),
    lengths=st.tuples(*[st.integers(0, 6)] * 3),
    joint=st.integers(-1, 5),
    frame=st.sampled_from(["", "base", "tool0"]),
)
def test_joints_are_the_same_bit_for_bit(what, names, lengths, joint, frame):
    position, velocity, effort = (
        [0.1 + i + 7 * k for i in range(n)] for k, n in enumerate(lengths)
    )
    message = fill(JointState(), frame, 5, 7)
    message.name, message.position, message.velocity, message.effort = (
        *(names, position, velocity, effort),
    )
    wanted = "" if joint < 0 else names[joint] if joint < len(names) else "nowhere"
    slow, quick = both_ways(what, message, "sensor_msgs/msg/JointState", wanted)
    assert repr(quick) == repr(slow)


@given(
    what=st.sampled_from(["force", "displacement"]),
    joint=st.sampled_from(["", "a", "b"]),
    stream=st.lists(
        st.tuples(
            st.sampled_from(["", "base", "tool"]),
            st.sampled_from([["a", "b"], ["b", "a"], ["b"], ["ab"]]),
            st.tuples(*[st.integers(0, 3)] * 3),
        ),
        min_size=2,
        max_size=6,
    ),
)
def test_a_stream_whose_messages_change_in_between_is_the_same_bit_for_bit(what, joint, stream):
    parameters = check({f"{what}.name": joint})
    slow, quick = Heard(), Heard()
    inputs = Inputs(parameters, slow)  # type: ignore[arg-type]
    handler = fast_handler(what, "sensor_msgs/msg/JointState", Inputs(parameters, quick))  # type: ignore[arg-type]
    assert handler is not None
    for number, (frame, names, lengths) in enumerate(stream):
        message = fill(JointState(), frame, number, 7)
        message.name = names
        message.position, message.velocity, message.effort = (
            [0.1 + i + 7 * k + 100 * number for i in range(n)] for k, n in enumerate(lengths)
        )
        inputs.add(what, message)
        handler(serialize(message))
    assert repr(quick.calls) == repr(slow.calls)


@pytest.mark.parametrize("kind", [WrenchStamped, PoseStamped, TransformStamped, PointStamped])
def test_bytes_cut_anywhere_are_left_to_the_class(kind):
    what = "force" if kind is WrenchStamped else "displacement"
    data = serialize(fill(kind(), "frame", 1, 2))
    inputs = Inputs(check({}), Heard())  # type: ignore[arg-type]
    handler = fast_handler(what, f"geometry_msgs/msg/{kind.__name__}", inputs)
    assert handler is not None
    for size in range(len(data)):
        with pytest.raises((UnusualError, struct.error)):
            handler(data[:size])
    big_endian = b"\x00\x00" + data[2:]
    with pytest.raises(UnusualError):
        handler(big_endian)


@given(frames=st.lists(st.tuples(texts, texts, vectors), max_size=3), cut=st.integers(0, 400))
def test_transforms_get_another_stamp_and_damaged_bytes_stay_as_they_are(frames, cut):
    message = TFMessage()
    for frame, child, value in frames:
        one = fill(TransformStamped(child_frame_id=child), frame, 1, 2)
        place = one.transform.translation
        place.x, place.y, place.z = value
        message.transforms.append(one)
    data = serialize(message)
    found = restamped_data(data, "tf2_msgs/msg/TFMessage", 5_000_000_007)
    for one in message.transforms:
        one.header.stamp.sec, one.header.stamp.nanosec = 5, 7
    assert found == serialize(message)
    if cut < len(data):
        assert restamped_data(data[:cut], "tf2_msgs/msg/TFMessage", 5_000_000_007) == data[:cut]
