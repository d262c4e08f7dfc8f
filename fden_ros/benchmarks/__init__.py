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

"""Benchmarks: measured figures held against stated goals, behind ``fden benchmark NAME``.

A benchmark is a module of this package with two functions, and a line in :data:`BENCHMARKS`:

``add_arguments(parser)``
    Add the benchmark's own arguments to an :class:`argparse.ArgumentParser`, with examples in
    ``parser.epilog`` where they teach. ``--quick``, ``--json`` and ``-o`` are there already. The
    module is imported only when its name is given, so it may import what it likes.

``run(args)``
    Measure, and return a :class:`Report`: goals, figures, tables and the picture. With
    ``args.quick`` it takes less than a minute, and goals that so little cannot decide have ``met``
    None. Seeds are fixed. Nothing is printed on standard output: long work shows its progress
    with :func:`progress`.

The command prints, writes NAME.json and NAME.png, and answers ``--json``::

    {"benchmark": "accuracy", "quick": false,
     "goals": [{"name": ..., "value": ..., "goal": ..., "met": true}, ...],
     "figures": {...}}
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import RenderableType

#: Name of every benchmark, which is that of its module, and what it measures in a line.
BENCHMARKS: dict[str, str] = {
    "accuracy": "errors over the Cramér-Rao bound, honesty of the intervals; simulated contacts",
    "exact": "false alarms, silent errors and honesty on tissue that obeys the law exactly",
    "laws": "tissue of other laws: does the next force lie in the interval of the prediction",
    "robots": "what a real rig adds: breathing, compliance, friction, hum; silent errors",
    "contact": "contacts invented, missed and split on a disturbed rig; detection alone",
    "changes": "inclusions and slides under the probe: how soon they are told; false ones",
    "replay": "speed and memory of replay and batch, beside merely decoding the same messages",
    "real": "prediction of measured holds of beef and silicone, beside the estimators of others",
    "classification": "probabilities that mean what they say, the unknown, lesions, real tissue",
    "configure": "what fden configure finds on simulated rigs of which nothing is known",
    "core": "a sample through the pipeline beside other fractional integrals, over its history",
    "node": "the node beside a bare relay on real DDS: losses, CPU, latency, memory",
}

#: Standard deviations of a normal variable that hold 95 % of it, on both sides [1].
TWO_SIDED_95 = 1.959964


@dataclass(frozen=True)
class Goal:
    """One figure and what it ought to be.

    Parameters
    ----------
    name : str
        What is measured; the same in every run.
    value : float, int, str or None
        The figure; None if it could not be measured.
    goal : str
        What it ought to be, such as ``<= 1.1``.
    met : bool or None
        None: this run cannot decide.
    """

    name: str
    value: float | int | str | None
    goal: str
    met: bool | None


def within(
    name: str,
    value: float,
    limits: tuple[float, float],
    interval: tuple[float, float] | None = None,
) -> Goal:
    """Return the goal that a figure lies within limits.

    Parameters
    ----------
    name, value
        As in :class:`Goal`; a value that is not finite has not been measured: undecided.
    limits : tuple of float
        Least and largest value; -inf or inf where there is no limit.
    interval : tuple of float, optional
        Confidence interval of `value`. Where it is given, it decides: inside the limits the goal
        is met, beyond them it is missed, and across one of them the run cannot tell.
    """
    low, high = limits
    if math.isfinite(low) and math.isfinite(high):
        words = f"{low:g} to {high:g}"
    else:
        words = f">= {low:g}" if math.isfinite(low) else f"<= {high:g}"
    if not math.isfinite(value):
        return Goal(name, None, words, None)
    least, largest = (value, value) if interval is None else interval
    met: bool | None = None
    if low <= least and largest <= high:
        met = True
    elif largest < low or least > high:
        met = False
    return Goal(name, float(value), words, met)


@dataclass(frozen=True)
class Report:
    """What a benchmark has found.

    Parameters
    ----------
    goals : sequence of Goal
    figures : mapping
        The figures behind the goals, ready for JSON; numbers that are not finite become null.
    tables : sequence
        What rich prints above the goals.
    draw : callable
        Draws the picture into a :class:`matplotlib.figure.Figure`, which it may resize.
    """

    goals: Sequence[Goal]
    figures: Mapping[str, Any]
    draw: Callable[[Figure], None]
    tables: Sequence[RenderableType] = field(default_factory=tuple)

    def json_object(self, benchmark: str, quick: bool) -> dict[str, Any]:
        """Return what ``--json`` prints."""
        whole = {
            "benchmark": benchmark,
            "quick": quick,
            "goals": [asdict(goal) for goal in self.goals],
            "figures": self.figures,
        }
        plain: dict[str, Any] = _plain(whole)
        return plain


def _plain(value: Any) -> Any:
    """Return `value` in the types of JSON: no numpy numbers, nothing that is not finite."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@contextmanager
def progress(description: str, total: int) -> Iterator[Callable[[], None]]:
    """Show a bar on standard error, if that is a terminal; the function it gives counts one on."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Remaining

    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Remaining(),
        console=Console(stderr=True),
        transient=True,
        disable=not sys.stderr.isatty(),
    )
    with bar:
        task = bar.add_task(description, total=total)
        yield lambda: bar.advance(task)
