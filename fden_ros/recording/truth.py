# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The truth that a simulated bag carries, as ``fden bag`` writes it."""

from __future__ import annotations

import json
from typing import Any

from fden_ros.errors import InputError
from fden_ros.recording.reader import BagReader, decode

TRUTH_TOPIC, TRUTH_TYPE = "/simulation/truth", "std_msgs/msg/String"


def read_truth(bag: BagReader) -> dict[str, Any] | None:
    """Return the truth that a simulated bag carries; None for any other bag."""
    for topic in bag.topics:
        if topic.name == TRUTH_TOPIC and topic.type_name == TRUTH_TYPE:
            for message in bag.messages([TRUTH_TOPIC]):
                return _parse_truth(decode(message).data)
    return None


def _parse_truth(text: str) -> dict[str, Any]:
    try:
        truth = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"{TRUTH_TOPIC} holds no JSON ({error}): make the bag anew") from None
    if not isinstance(truth, dict):
        raise InputError(f"{TRUTH_TOPIC} holds no JSON object: make the bag anew")
    return truth
