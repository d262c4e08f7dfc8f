# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""One record of all presses of a place, and when its grid is laid anew.

Each block of the press appends a cell. One round is laid at a time, of the record by then:
nothing has to be caught up with. The posterior is at any time that of the newest grid and the
cells since; nothing is claimed of one that is not settled.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from fden_ros.core.estimation.cells import CREEP_RATES, Place, Press, gathered
from fden_ros.core.estimation.change import ChangeGate
from fden_ros.core.estimation.covariance import Noise
from fden_ros.core.estimation.estimate import LawError
from fden_ros.core.estimation.face import Innovation, Setting, Touch
from fden_ros.core.estimation.filter import Filter
from fden_ros.core.estimation.grid import (
    LAST_ROUNDS,
    Grid,
    Start,
    begun,
    continued,
    laid,
    leads_to,
    log_evidence_of,
    moments_of,
    rounds,
)
from fden_ros.core.estimation.law import Law
from fden_ros.core.estimation.nuisance import Nuisance, rig_of, spot_of
from fden_ros.core.estimation.posterior import Posterior
from fden_ros.core.estimation.record import LINE_TOLERANCE, TOUCH_TIME, Block, Record
from fden_ros.core.estimation.rival import Rival

#: Blocks and time [s] from the touch that the first grid of a press needs: until then each sample
#: is a block.
_LEAST_BLOCKS, _LEAST_TIME = 8, TOUCH_TIME
#: A grid is laid anew where depth or time have grown by this factor [1].
_GROWTH = 1.25
#: Cells of a press that is gathered, and when it is gathered anew [1].
_GATHERED, _MOST = 40, 72
#: Presses of a place in its record; of older ones the stress acts on, and no more is learned [1].
_PRESSES = 3
#: A grid is laid anew where its mean is off the middle of its box by this, in its deviations, or
#: its deviations are less than this part of the box's [1].
_MOST_OFF, _LEAST_SPREAD = 1.0, 0.5
#: A round refutes the grid that had settled before where its mean is off by more than this, in
#: the deviations of that grid [1].
_REFUTED = 3.0
#: A grid is laid from nothing too where the time of a press has grown by this factor since the
#: last [1], and by the second at its end: scales that were small are left only where the columns
#: are those of larger ones, and the log evidence was up to 15 lower.
_AFRESH, _AFRESH_END = 2.0, 1.4
#: That time in a first press [s].
_FIRST_AFRESH = 0.1
#: Standard deviation of ln N/m for a relaxation that has not been seen, over the stated
#: discrepancy of the law [1]: on a ramp only the curve is.
_UNSEEN = 0.5
#: A probe moves above this part of its largest speed [1].
_MOVING = 0.05
#: The probe holds below this part of its largest speed, by as many standard deviations [1].
_SLOW, _SPEED_DEVIATIONS = 0.5, 2.0


class PlacePosterior:
    """The posterior of one place.

    Attributes
    ----------
    filter : Filter or None
        The weighted nodes; None: there are none yet.
    innovation : Innovation or None
        Of the newest block.
    gate : ChangeGate
        Says whether the tissue under the probe has changed since the touch.
    laid_at : float
        When the newest grid was laid, since the touch [s].
    """

    def __init__(self, setting: Setting, noise_sd: float = 0.0) -> None:
        self.setting = setting
        self.filter: Filter | None = None
        self.innovation: Innovation | None = None
        self.deepest = -math.inf
        self.now = 0.0
        self.noise_sd = noise_sd
        self._ended: list[Press] = []
        self._older, self._older_end = np.zeros(CREEP_RATES.size), 0.0
        self._touch: Touch | None = None
        self._began = 0.0
        self._record: Record | None = None
        self._press: Press | None = None
        self._tails: list[Press] = []  #: of the press, since the newest grid
        self._blocks = 0
        self._newest: Block | None = None
        #: Blocks that wait to be gathered to fewer cells, and those that have come since.
        self._waiting: tuple[list[Block], list[Block]] | None = None
        self.laid_at = 0.0
        self._laid_deep = 0.0  #: the deepest indentation by then [1]
        self._fastest = 0.0
        self.has_slowed = False
        self.gate = ChangeGate()
        self._afresh_at = 0.0
        self._starts: list[Start] = []  #: of grids from nothing, the first of its next round
        #: Of the last grid that had settled, with the cells since, until the next one has.
        self._settled: Filter | None = None
        self._elsewhere: Grid | None = None  #: from nothing, settled at another mode
        #: A grid from nothing has settled, or was given up: two modes may explain the beginning of
        #: a first press alike.
        self.has_searched = False
        self._rival = Rival()
        self._law_error: tuple[Grid, LawError | None] | None = None  #: and the grid that it is of
        self._spots: dict[int, tuple[Nuisance, ...]] = {}
        self._spot = 0  #: where the press is

    @property
    def presses(self) -> int:
        """Presses so far, with the present one."""
        return len(self._ended) + (self._record is not None)

    @property
    def elapsed(self) -> float:
        """Time since the touch [s]."""
        return max(self.now - self._began, 1e-3)

    @property
    def log_evidence(self) -> float:
        """Log evidence of the record by now; 0 where there is none."""
        return self.filter.log_evidence if self.filter is not None else 0.0

    @property
    def plateau_probability(self) -> float:
        """Probability that the relaxation has a plateau [1]; NaN: it was not asked for."""
        return self._rival.probability

    def continued(self, contact_point_sd: float | None = None) -> PlacePosterior:
        """Return a copy, for a press that may be of this place.

        `contact_point_sd`: it may be of another spot of this tissue, whose contact point has this
        standard deviation [1]; None: of the same spot.
        """
        found = self._copied()
        if contact_point_sd is not None:
            found._spot = max([*self._spots, 0]) + 1
            found._spots = self._spots | {found._spot: spot_of(contact_point_sd)}
        return found

    def _copied(self) -> PlacePosterior:
        found = copy.copy(self)
        found._ended, found._rival = list(self._ended), copy.copy(self._rival)
        return found

    @property
    def unseen(self) -> float:
        """Standard deviation of ln N/m, or of ln stress, for a relaxation not seen yet [1]."""
        is_seen = self.has_slowed or self.presses > 1
        return 0.0 if is_seen else _UNSEEN * self.setting.config.uncertainty.characteristic_sd

    @property
    def count(self) -> int:
        """Cells of the record by now."""
        return self.filter.count if self.filter is not None else 0

    @property
    def behind(self) -> int:
        """Blocks since the newest grid."""
        return len(self._tails)

    @property
    def is_resolved(self) -> bool:
        """Whether the newest grid resolves the posterior by now."""
        return self.filter is not None and self.filter.is_resolved

    @property
    def is_settled(self) -> bool:
        """Whether a grid resolves the posterior by now."""
        return self._settled is not None or self.is_resolved

    @property
    def told(self) -> Filter | None:
        """The weighted nodes of the newest grid that has settled, or of the newest."""
        return self._settled or self.filter

    # A press

    @property
    def reach(self) -> float:
        """How far before its nominal place the surface may be [1]; 0: it is known."""
        is_one_sided = self.setting.geometry.is_one_sided
        return 6.0 * self.setting.contact_point_sd if is_one_sided else 0.0

    def touch(self, touch: Touch, now: float, reach: float) -> None:
        """Begin a press at a time [s]; `reach`: of the motion that its record begins with [1]."""
        # At rest in a later press too, so that records of one touch have the same cells.
        is_one_sided = self.setting.geometry.is_one_sided
        self._record = Record(self.noise_sd, reach, is_at_rest=is_one_sided)
        approach = touch.approach + np.array([[now], [0.0], [0.0]])
        self._record.approach.add(approach, LINE_TOLERANCE + 4.0 * self.noise_sd)
        self._touch, self._press, self._tails, self.now = touch, None, [], now
        self._began, self._steps, self._blocks = now, 0, 0
        self._newest = self._waiting = None
        self._is_pressed = self.has_slowed = False
        self._fastest = self._afresh_at = 0.0
        self.gate, self._starts, self._elsewhere = ChangeGate(), [], None
        self._settled = None

    def add(self, time: float, indentation: float, stress: float, *, on_tissue: bool) -> bool:
        """Take a sample; return whether it completes a block."""
        record, setting = self._record, self.setting
        assert record is not None
        if time > self.now:
            self._steps += 1
            if setting.path_variance:
                # By the mean step: the last alone may be short.
                mean_step = (time - self._began) / self._steps
                self.noise_sd = math.sqrt(setting.path_variance / mean_step)
                record.noise_sd = record.noise_sd or self.noise_sd
        self.now = time
        self._is_pressed |= on_tissue
        # Before the first stress the force counts as well: there is none.
        is_observed = on_tissue or not self._is_pressed
        done = record.add(time, indentation, stress, is_observed=is_observed)
        for block in done:
            self._append(block)
        return bool(done)

    def _append(self, block: Block) -> None:
        self._newest = block
        self._blocks += 1
        if block.is_observed:
            self.deepest = max(self.deepest, block.indentation)
            self._see_speed(block)
        if self.is_laid:
            found = self._follow(block)
            if self._settled is not None:
                self._settled.append(self._tails[-1])
                self._settled = self._settled if self._settled.is_resolved else None
            if found is not None:
                self._see_innovation(found)
        if self._waiting is not None:
            self._waiting[1].append(block)
        elif block.is_observed and self._is_full(block):
            blocks = self._observed()
            if len(blocks) >= _LEAST_BLOCKS:
                self._waiting = blocks, []

    def _follow(self, block: Block) -> Innovation | None:
        assert self.filter is not None
        tail = self.filter.path.tail(block, self.noise_sd)
        self._tails.append(tail)
        return self.filter.append(tail)

    def _is_full(self, newest: Block) -> bool:
        """Whether the first grid of a press is due, or one of fewer cells, as there are many."""
        if self.is_laid:
            return self._cells >= _MOST
        return self._blocks >= _LEAST_BLOCKS and newest.middle - self._began >= _LEAST_TIME

    @property
    def is_laid(self) -> bool:
        """Whether there is a grid of the press."""
        return self._press is not None

    @property
    def is_waiting(self) -> bool:
        """Whether blocks wait to be gathered."""
        return self._waiting is not None

    def ask(self) -> bool:
        """Lay one round of another grid: from nothing, or of a rival; False: nothing is due."""
        if self._starts:
            self._lay_afresh()
        elif self.filter is not None and self._rival.is_due(self.laid_at):
            self._rival.lay(self.filter)
        else:
            return False
        return True

    def _see_innovation(self, found: Innovation) -> None:
        """Look for a change, but in a retreat: a force ahead of the motion falls before that."""
        assert self.filter is not None
        self.innovation, newest = found, self._tails[-1]
        if float(newest.speeds[-1]) < -_MOVING * self._fastest:
            self.gate.rest()
        else:
            self.gate.see(self.filter, newest, found, self.unseen)

    def _see_speed(self, block: Block) -> None:
        """Take the speed of a block, as far as its noise lets it be known."""
        if not block.slope_sd:
            return
        noise = _SPEED_DEVIATIONS * block.slope_sd * self.noise_sd
        self._fastest = max(self._fastest, block.slope - noise)
        self.has_slowed |= abs(block.slope) + noise < _SLOW * self._fastest

    @property
    def is_due(self) -> bool:
        """Whether a round is to be laid.

        As the record has grown, or the nodes have moved out of the middle of their box; the
        second and further rounds of a grid that is not settled.
        """
        if not self.is_laid or self._newest is None or not self._newest.is_observed:
            return False
        if self.gate.is_beyond:
            return False
        assert self.filter is not None
        grid = self.filter.grid
        is_given_up = not grid.is_settled and grid.after.rounds % LAST_ROUNDS == 0
        if not self.is_resolved and not is_given_up:
            return True
        before = sum(press.end - press.start for press in self._ended)
        elapsed = before + self._newest.middle - self._began
        if elapsed > _GROWTH * (before + self.laid_at) or self.deepest > _GROWTH * self._laid_deep:
            return True
        return not is_given_up and self._has_moved()

    def _has_moved(self) -> bool:
        assert self.filter is not None
        mean, covariance = moments_of(self.filter.weights, self.filter.grid.nodes)
        box = self.filter.grid.start.box
        sds = np.maximum(box.deviations, 1e-12)
        own = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
        off = np.abs(mean - box.mean) / sds
        is_open = self.filter.grid.law.coordinates[1] > 0.0
        return bool(np.any(off > _MOST_OFF) or np.any((own < _LEAST_SPREAD * sds)[is_open]))

    @property
    def _cells(self) -> int:
        """Cells of the press by now."""
        assert self._press is not None
        return self._press.middles.size + sum(tail.middles.size for tail in self._tails)

    # Laying

    def _law(self, press: Press) -> Law:
        setting = self.setting
        assert self._touch is not None
        presses = (*self._ended, press)
        place = Place(presses, self._older, self._older_end or presses[0].start)
        rig = rig_of(setting.config, setting.geometry, self._touch.bias_sd, self._touch.drift_sd)
        rig = rig._replace(spots=self._spots)
        return Law(setting.config, setting.geometry, place, rig, setting.contact_point_sd)

    def _observed(self) -> list[Block]:
        """Return the blocks up to the last that was observed."""
        assert self._record is not None
        blocks = self._record.blocks
        last = max((k for k, block in enumerate(blocks) if block.is_observed), default=-1)
        return blocks[: last + 1]

    def gather(self) -> None:
        """Lay one round of the blocks that have waited, gathered, and follow those since."""
        assert self._waiting is not None
        (blocks, since), self._waiting = self._waiting, None
        self._lay_gathered(blocks)
        for block in since:
            self._follow(block)

    def lay(self) -> None:
        """Lay one round of the record by now."""
        assert self._press is not None
        self._lay(self._press.appended(self._tails).remembered())

    def _lay_gathered(self, blocks: list[Block]) -> None:
        self._lay(replace(gathered(blocks, self.noise_sd, _GATHERED), spot=self._spot))

    def _lay(self, press: Press) -> None:
        if self.is_laid and self.is_resolved:
            self._settled = self.filter
        self._press = press
        self._tails.clear()
        law = self._law(press)
        noise = Noise(self.setting.noise_sd, self.noise_sd)
        if self.filter is None:
            (start,) = begun(law, noise)
        else:
            moments = moments_of(self.filter.weights, self.filter.grid.nodes)
            start = continued(law, self.filter.grid, *moments, self.filter.log_leading)
        grid = laid(law, noise, start)
        self._take(grid)
        elapsed = self.now - self._began
        may_search = self.has_slowed or (not self._ended and elapsed > _AFRESH * _FIRST_AFRESH)
        if may_search and elapsed > _AFRESH * self._afresh_at:
            self._afresh_at, self._starts = elapsed, begun(law, noise, grid)

    def _take(self, grid: Grid) -> None:
        self.filter = Filter(grid)
        told = self._settled
        if told is not None and (
            grid.is_settled
            or grid.after.rounds >= LAST_ROUNDS
            or _off(told, self.filter) > _REFUTED
        ):
            self._settled = None
        self.laid_at, self._laid_deep = self.now - self._began, self.deepest
        self._rival.see(self.filter, can_tell=self.has_slowed and not self._ended)

    def _lay_afresh(self) -> None:
        """Lay one round of a grid from nothing, of the record of the newest grid; take a likelier.

        The record may be longer than that of the round before.
        """
        assert self.filter is not None
        own, (start, *others) = self.filter.grid, self._starts
        about = own.law.stressed(start.about)
        grid = laid(own.law, own.noise, start._replace(about=about))
        is_near = leads_to(grid, own)
        has_ended = is_near or grid.is_settled or grid.after.rounds >= LAST_ROUNDS
        self._starts = others if has_ended else [grid.after, *others]
        self.has_searched |= not self._starts
        if is_near or not grid.is_settled:
            return
        if _likelier(own, grid) is grid:
            self._take(grid)
            self.lay()
        else:
            self._elsewhere = grid

    def branched(self, known: Sequence[Grid]) -> PlacePosterior | None:
        """Return the place at a less likely mode of its posterior; None: none has been found.

        It is found once: evidences tell the modes that are `known` from now on.
        """
        grid, self._elsewhere = self._elsewhere, None
        if grid is None or any(leads_to(grid, one) for one in known):
            return None
        found = self._copied()
        found.gate, found._record = copy.copy(self.gate), copy.deepcopy(self._record)
        found._tails = list(self._tails)
        found._take(grid)
        assert found.filter is not None
        for tail in found._tails:
            found.filter.append(tail)
        return found

    def release(self) -> Iterator[None]:
        """End the press: rounds until the grid is settled, one at a time."""
        if self._record is None:
            return
        for block in self._record.close():
            self._append(block)
        if self.is_waiting or self.is_laid:
            self._waiting = None
            self._lay_gathered(self._observed())
            yield
            assert self.filter is not None and self._press is not None
            if self.elapsed > _AFRESH_END * self._afresh_at:
                own = likelier = self.filter.grid
                for afresh in rounds(own.law, own.noise, own):
                    likelier = _likelier(likelier, afresh)
                    yield
                self._take(likelier)
            self.has_searched = True
            for _ in range(LAST_ROUNDS):
                if self.filter.grid.is_settled:
                    break
                self.lay()
                yield
            self._settled = None
            self._ended.append(self._press)
        self._record = self._press = None
        if len(self._ended) > _PRESSES:
            self._forget()

    def ask_rival(self) -> Iterator[None]:
        """Find the probability of a plateau at the end of the press, one round at a time."""
        if self.filter is not None:
            yield from self._rival.end(self.filter, self.elapsed)

    def _forget(self) -> None:
        """Keep of the oldest press what the tissue remembers."""
        press = self._ended.pop(0)
        if self._ended[0].spot != press.spot:
            self._older, self._older_end = np.zeros(CREEP_RATES.size), 0.0
            return
        end = self._older_end or press.start
        decay = np.exp(-CREEP_RATES * (press.end - end))
        self._older = decay * self._older + press.into_moments @ np.maximum(press.stresses, 0.0)
        self._older_end = press.end

    def posterior(self) -> Posterior | None:
        """Return the posterior by now; None: there is none."""
        return Posterior.of(self.told) if self.told is not None else None

    def law_error(self, posterior: Posterior) -> LawError | None:
        """Return how far the data bend the law, by the newest grid; None: it is said to be exact.

        `posterior`: the present one.
        """
        if self._law_error is None or self._law_error[0] is not posterior.grid:
            self._law_error = posterior.grid, posterior.law_error(self.elapsed, self.deepest)
        return self._law_error[1]


def _off(one: Filter, other: Filter) -> float:
    """Return how far the mean of another laying is off, in deviations."""
    mean, covariance = moments_of(one.weights, one.grid.nodes)
    off = np.abs(other.weights @ other.grid.nodes - mean)
    return float(np.max(off / np.sqrt(np.maximum(covariance.diagonal(), 1e-24))))


def _likelier(one: Grid, other: Grid) -> Grid:
    """Return the likelier of two grids of one record; one that is not settled is not taken."""
    if not other.is_settled:
        return one
    logs = [log_evidence_of(g.law, g.stiffness.log + g.log_prior) for g in (one, other)]
    return other if logs[1] > logs[0] or not one.is_settled else one
