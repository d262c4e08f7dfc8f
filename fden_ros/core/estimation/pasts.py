# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""The pasts that the tissue under the probe may have had, and what they carry to the next press.

A touch may be of the place before or of another: each past has its prior, its memory and its odds.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import replace

from scipy.special import logsumexp

from fden_ros.core.estimation.hypothesis import Hypothesis, Past
from fden_ros.core.estimation.mixture import collapsed, normalized
from fden_ros.core.estimation.press_model import FreeSurface
from fden_ros.core.estimation.press_setting import Carried, PressSetting, is_sound
from fden_ros.core.estimation.proposals.place import Tissue, log_odds_of_another
from fden_ros.core.estimation.unknowns import Lifetime


class Pasts:
    """The pasts of the tissue under the probe.

    Parameters
    ----------
    setting : PressSetting
        What is known of tissue that was not touched.

    Attributes
    ----------
    all : list of Past
        After a press the likeliest is the first.
    """

    def __init__(self, setting: PressSetting) -> None:
        self.all = [Past(setting)]
        self._time = self._stress = 0.0  # of the newest that they remember

    @property
    def weighed(self) -> list[tuple[float, Past]]:
        """Those with their probabilities before the present press."""
        if len(self.all) == 1:
            return [(1.0, self.all[0])]
        total = float(logsumexp([past.log_odds for past in self.all]))
        return [(math.exp(past.log_odds - total), past) for past in self.all]

    def remember(self, time: float, stress: float) -> None:
        """Take the mean stress of a block that ends at a time into the tissue's memory."""
        step = time - self._time
        if step > 0.0:
            for past in self.all:
                past.memory.add(step, self._stress, stress)
            self._time, self._stress = time, stress

    def wait(self, time: float) -> None:
        """Let the tissue's memory fade until a time."""
        for past in self.all:
            past.memory.wait(time - self._time)
        self._time = time

    def may_be_of(self, other: Pasts, shift: float, last: Tissue, log_wider: float) -> None:
        """Take the two likeliest pasts of another site beside the own, which is not touched yet.

        Parameters
        ----------
        other : Pasts
            They are not used any more.
        shift : float
            By which its compressions are larger [1].
        last : Tissue
            What was touched there.
        log_wider : float
            Of the origin's prior, as of :func:`log_odds_of_another`.
        """
        (own,) = self.all
        setting = own.setting
        own.other = log_odds_of_another(setting.config, last, log_wider)
        same = other.all[:2]
        total = float(logsumexp([past.log_odds for past in same]))
        for past in same:
            past.setting = replace(
                past.setting, config=setting.config, stress_sd=setting.stress_sd
            )
            past.shift += shift
            past.log_odds -= total
            past.other = None
        self.all = [*same, own]

    def hypotheses(self, zero_sd: float, drift_sd: float) -> list[Hypothesis]:
        """Return those of a press that begins where the memory of the pasts ends.

        There is one for each Gaussian of what a past has carried over.

        Parameters
        ----------
        zero_sd, drift_sd : float
            Of the press's own zero [Pa] and drift [Pa/s]; a zero_sd of 0: it is not measured.
        """
        found = []
        for past in self.all:
            own = past.setting
            setting = replace(
                own,
                # 0.01 N where it is not measured: with 0 a preload puts ln Gn eight standard
                # deviations off.
                zero_sd=zero_sd or 0.01 * own.geometry.stress_per_force,
                drift_sd=drift_sd,
            )
            if setting.carried is None:
                found.append(Hypothesis(past, setting))
                continue
            free = FreeSurface(copy.deepcopy(past.memory), self._time)
            for part in setting.carried.parts:
                found.append(Hypothesis(past, replace(setting, carried=part, free=free)))
        return found

    def carry(self, weighed: Sequence[tuple[float, Hypothesis]], deepest: float) -> None:
        """Make the posterior of a press the prior of the next, for each past that it leaves.

        Parameters
        ----------
        weighed : sequence of (float, Hypothesis)
            Its hypotheses with their weights.
        deepest : float
            Its largest compression, as it is given [1].
        """
        pasts: list[Past] = []
        for _, one in weighed:
            if all(one.past is not past for past in pasts):
                pasts.append(one.past)
        for past in pasts:
            own = [(weight, one) for weight, one in weighed if one.past is past]
            # All carry over three Gaussians together: each is a hypothesis of the next press.
            _carry_over(past, own, deepest, self._time, max(3 // len(pasts), 1))
        self.all = sorted(pasts, key=lambda past: -past.log_odds)


def _carry_over(
    past: Past, own: Sequence[tuple[float, Hypothesis]], deepest: float, time: float, most: int
) -> None:
    """Put what a press has told into a past: all of its own hypotheses, in a few Gaussians.

    `time`: at which its memory is what it is [s]; `most`: Gaussians.
    """
    _, likeliest = max(own, key=lambda pair: pair[0])
    past.log_odds = math.log(sum(weight for weight, _ in own))
    past.deepest = likeliest.deepest(deepest)
    past.other = None
    if likeliest.solved is None:
        return
    model = likeliest.solved.model
    # A solution of a shorter record may lack the law's errors of this one.
    whole = normalized(
        [
            part._replace(weight=weight * part.weight)
            for weight, other in own
            if other.solved is not None and other.solved.model.last_knot == model.last_knot
            for part in other.modes_now
        ]
    )
    sound = [part for part in whole if is_sound(part)] or whole[:1]
    lasting = [k for k, one in enumerate(model.unknowns) if one.lifetime is not Lifetime.CONTACT]
    # Two Gaussians are one where the divergence grows by less than 0.5. With 0.1 three presses to
    # a strain of 1.2/Gn tell 0.08 more of the truth's log density, but a usual second press may
    # take half as much work again.
    carried = Carried(model, collapsed(normalized(sound), most, 0.5, lasting))
    past.setting = replace(past.setting, carried=carried)
