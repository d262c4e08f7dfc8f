# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Whether the tissue under the probe has changed, or was never what the model says."""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import NamedTuple

from fden_ros.core.arrays import Array
from fden_ros.core.estimation.estimator import Block, Innovation
from fden_ros.core.estimation.innovation_monitor import (
    CHANGE_DEVIATIONS,
    LONGEST_CHANGE_WINDOW,
    InnovationMonitor,
)

#: An innovation whose variance is below this many times the noise's [1] is the noise's, not the
#: state's: only such are tested.
_MOST_NOISE_SHARE = 2.0
#: Any innovation is tested whose square is beyond the threshold by this factor [1]: in first order
#: a state is not known to be off by more than twice its deviations.
_CLEARLY = 4.0
#: Innovations [1] after which a mismatch is reported, unless a change of the tissue explains it: a
#: change shows within the longest window of change.
_MISMATCH_DELAY = LONGEST_CHANGE_WINDOW
#: An innovation beyond this many standard deviations [1] makes the estimate doubtful for this many
#: blocks [1]: by then the tests have decided what it was.
_SURPRISING, _DOUBTFUL_BLOCKS = 4.5, 8
#: Blocks in a row [1], and their time [s], that each are a surprise and together a change: four
#: of 10 ms, or two where a sensor is so slow that each of its samples is a block.
_SURPRISES, _SURPRISE_TIME = 2, 0.0399
#: After a change, for this time [s], the shape of the pulse matters too much to learn anything:
#: ten blocks by default. Half finds the same changes; twice moves the estimates after one.
_BLIND_TIME = 0.1
#: A surprise begins a change only where the law fitted before: the median normalised square of so
#: many innovations before it is below this [1]. Where the law holds it is 0.5; on a cubic law and
#: on a power law of strain, which the law follows ever later, 4 to 10.
_BEFORE, _MOST_UNREST = 16, 3.0
#: Changes on one site [1]: a tissue that changes oftener is none that the model describes.
_MOST_CHANGES = 2


class Change(NamedTuple):
    """A change of the tissue."""

    time: float  #: of the first block that shows it [s]
    state: Array | None  #: the last state before it, shape (n,); None: the present one


class Knowledge(NamedTuple):
    """What was known when a block came: it decides which innovation is a surprise."""

    noise: float  #: variance of the block's mean stress, the walk's own part included [Pa^2]
    state: Array  #: by which the block was predicted, shape (n,)
    is_unimodal: bool  #: the posterior is normal
    is_fresh: bool  #: the state holds all blocks before this one
    #: The law holds without a model's error: only then is a deviation that came slowly a change.
    is_exact: bool
    is_surprise: bool  #: no scale of the model's error foresaw the block


class TissueChange:
    """Tests of the innovations of one site."""

    def __init__(self) -> None:
        #: Changes found so far.
        self.count = 0
        self._monitor = InnovationMonitor()
        self._was_mismatch = False
        self._surprises = 0
        self._first_surprise = 0.0
        self._blind_until = -math.inf
        self._recent_states: deque[tuple[float, Array]] = deque(maxlen=LONGEST_CHANGE_WINDOW + 2)
        self._doubtful_blocks = 0
        self._before: deque[float] = deque(maxlen=_BEFORE)

    @property
    def is_doubtful(self) -> bool:
        """Whether a surprise or a mismatch of late is not explained yet."""
        return self._doubtful_blocks > 0 or 0 < self._monitor.mismatch_count <= _MISMATCH_DELAY

    @property
    def is_mismatch(self) -> bool:
        """Whether the innovations are larger or slower than an exact law and noise explain."""
        return self._was_mismatch or self._monitor.mismatch_count > _MISMATCH_DELAY

    @property
    def inflation(self) -> float:
        """Factor by which the variance of the estimate is too small, at least 1."""
        return self._monitor.inflation

    def begin_contact(self) -> None:
        """Let a new contact begin: the mismatch before an earlier change is forgotten."""
        self._was_mismatch = False

    @property
    def is_suspected(self) -> bool:
        """Whether the newest block was a surprise: perhaps the first of a change."""
        return self._surprises > 0

    def is_blind(self, time: float) -> bool:
        """Whether a block at `time` [s] is too soon after a change to be used."""
        return time < self._blind_until

    def watch(self, block: Block, innovation: Innovation, known: Knowledge) -> Change | None:
        """Test the innovation of a block; return the change that it proves."""
        self._doubtful_blocks = max(self._doubtful_blocks - 1, 0)
        if innovation.normalized_squared > _SURPRISING**2:
            self._doubtful_blocks = _DOUBTFUL_BLOCKS
        if self.is_blind(block.memory_time):
            return None
        is_settled = innovation.variance <= _MOST_NOISE_SHARE * known.noise
        may_change = self.count < _MOST_CHANGES
        is_surprising = self._is_surprising(innovation, known, is_settled=is_settled)
        self._surprises = self._surprises + 1 if is_surprising and may_change else 0
        if self._surprises == 1:
            self._first_surprise = block.memory_time
        if not is_surprising:
            self._before.append(innovation.normalized_squared)
        lasted = block.memory_time - self._first_surprise + block.duration
        if self._surprises >= _SURPRISES and lasted >= _SURPRISE_TIME:
            return self._begin_anew(block, Change(self._first_surprise, None))
        if not (is_settled and known.is_fresh and known.is_exact):
            # Two innovations by one state are not independent.
            return None
        self._monitor.add(innovation.innovation / math.sqrt(innovation.variance))
        self._recent_states.append((block.memory_time, known.state.copy()))
        if not (self._monitor.change_window and may_change):
            return None
        # The blocks since the change have spoilt the present state.
        first = max(len(self._recent_states) - self._monitor.change_window, 0)
        changed_at, _ = self._recent_states[first]
        _, before = self._recent_states[max(first - 1, 0)]
        return self._begin_anew(block, Change(changed_at, before))

    @property
    def _fitted(self) -> bool:
        """Whether the innovations before were those of a law that holds."""
        return not self._before or median(self._before) < _MOST_UNREST

    def _is_surprising(
        self, innovation: Innovation, known: Knowledge, *, is_settled: bool
    ) -> bool:
        """Whether an innovation may be the first of a change, or goes on with one.

        A first surprise needs a state that is known better than the noise (`is_settled`), or to be
        one of a much less certain state; one that follows a surprise does not, because the
        surprise has widened the state.
        """
        is_clear = innovation.innovation**2 > CHANGE_DEVIATIONS**2 * _CLEARLY * innovation.variance
        return (
            known.is_surprise
            and (is_settled or is_clear or not known.is_unimodal or self._surprises > 0)
            and (known.is_exact or self._surprises > 0 or self._fitted)
        )

    def _begin_anew(self, block: Block, change: Change) -> Change:
        self._blind_until = block.memory_time + _BLIND_TIME
        # A mismatch before the change is not explained by it.
        self._was_mismatch = self.is_mismatch
        self._before.clear()
        self._surprises = 0
        self._monitor = InnovationMonitor()
        self._recent_states.clear()
        self.count += 1
        return change
