# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""What of a benchmark is measured: the user's choice by names, separated by commas."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeVar

from fden_ros.errors import InputError

Thing = TypeVar("Thing")


def chosen(
    names: str | None, known: Mapping[str, Thing], kind: str, default: Iterable[str]
) -> list[Thing]:
    """Return what has these names, in their order.

    Parameters
    ----------
    names : str or None
        Separated by commas; None: those of `default`.
    known : mapping
        All there are, by their names.
    kind : str
        What one of them is called.
    default : iterable of str

    Raises
    ------
    InputError
        If there is none of a name, or none is named.
    """
    wanted = list(default) if names is None else [name for name in names.split(",") if name]
    for name in wanted:
        if name not in known:
            raise InputError(f"there is no {kind} {name!r}; there are {', '.join(known)}")
    if not wanted:
        raise InputError(f"no {kind} is named; there are {', '.join(known)}")
    return [known[name] for name in wanted]
