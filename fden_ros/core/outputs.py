# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""What leaves the core: states, classifications, summaries and complex moduli."""

from __future__ import annotations

import enum
import traceback
from collections.abc import Sequence
from dataclasses import dataclass, replace

from fden_ros.core.classification import ClassProbabilities, Comparison, Decided, Decision
from fden_ros.core.estimation import (
    Budget,
    Estimate,
    EstimatorConfig,
    Innovation,
    ParameterSet,
)
from fden_ros.core.law import ApparentStiffness as ApparentStiffness
from fden_ros.core.oscillation import ComplexModulus
from fden_ros.core.stiffness import NOT_MEASURED, Slopes
from fden_ros.core.streams import Position


class Status(enum.IntEnum):
    """What a consumer may do with a :class:`TissueState`."""

    UNKNOWN = 0
    NO_CONTACT = 1
    CONVERGING = 2
    CONVERGED = 3
    STALE = 4
    LATE = 5


class Phase(enum.IntEnum):
    """What the probe is doing."""

    NONE = 0
    APPROACH = 1
    LOADING = 2
    HOLDING = 3
    UNLOADING = 4


class Flag(enum.IntFlag):
    """What qualifies a state, besides its status."""

    NONE = 0
    INPUT_REJECTED = 1
    GAP = 2
    MODEL_MISMATCH = 4
    TOUCH_NOT_OBSERVED = 8
    TISSUE_CHANGED = 16
    SATURATED = 32
    ESTIMATION_FAILED = 64
    AT_PRIOR_LIMIT = 128
    GEOMETRY_UNSTATED = 256
    IMPLAUSIBLE = 512
    FORCE_DRIFTED = 1024
    RIG_PRIOR_CONFLICT = 2048
    ALPHA_PRIOR_CONFLICT = 4096


#: With one of these flags no estimate converges, whatever the data.
WITHHELD = Flag.GEOMETRY_UNSTATED | Flag.IMPLAUSIBLE


class OrderSource(enum.IntEnum):
    """Where alpha comes from."""

    NONE = 0
    GIVEN = 1
    PRIOR = 2
    LEARNED = 3


@dataclass(frozen=True)
class Signals:
    """Means over a block."""

    strain: float  #: x from the strain origin [1]
    stress: float  #: f [Pa]
    fractional_stress: float  #: f' [Pa s^alpha]


@dataclass(frozen=True)
class TissueState:
    """What is known after a block of samples."""

    stamp_ns: int
    status: Status
    flags: Flag
    site_id: int
    contact_id: int
    phase: Phase
    order_source: OrderSource = OrderSource.NONE
    estimate: Estimate | None = None
    signals: Signals | None = None
    innovation: Innovation | None = None
    apparent_stiffness: ApparentStiffness | None = None
    lag: float = 0.0  #: from sample to estimate [s], set by a caller that has a clock
    measured: Slopes = NOT_MEASURED  #: the newest slopes of force over displacement


@dataclass(frozen=True)
class Classification:
    """The tissue's class, as far as the data show it."""

    stamp_ns: int
    decision: Decision
    site_id: int
    contact_id: int
    flags: Flag
    classes: ClassProbabilities | None
    library_name: str
    decided: Decided | None = None
    comparison: Comparison | None = None


@dataclass(frozen=True)
class ContactSummary:
    """One contact, from onset to release."""

    stamp_ns: int
    start_ns: int
    end_ns: int
    site_id: int
    contact_id: int
    flags: Flag
    converged: bool
    complete: bool
    position: Position | None
    order_source: OrderSource
    estimate: Estimate | None
    max_strain: float
    max_stress: float
    max_force: float
    sample_count: int
    rejected_count: int
    classes: ClassProbabilities | None
    decided: Decided | None = None
    comparison: Comparison | None = None
    #: At the deepest point of the contact.
    apparent_stiffness: ApparentStiffness | None = None
    #: What makes the estimate uncertain where it has not converged.
    budget: Budget | None = None
    #: Slopes of force over displacement at the deepest point; of a place on a path the newest.
    measured: Slopes = NOT_MEASURED
    position_frame: str = ""  #: of `position`, as the pipeline's caller states it

    @property
    def is_of_path(self) -> bool:
        """Whether it is a place on the path of a continuous contact whose stiffness is known."""
        if self.apparent_stiffness is None or Flag.TOUCH_NOT_OBSERVED not in self.flags:
            return False
        # Along a path G is never determined, Gn sometimes; a press begun unseen may have it.
        estimate = self.estimate
        return estimate is None or not estimate.observable & ParameterSet.LINEAR_STIFFNESS


def is_path(summaries: Sequence[ContactSummary]) -> bool:
    """Return whether contacts are places on a path: their stiffness is known, no touch was seen.

    Where a touch was seen, a contact that began unseen is an ordinary contact.
    """
    return any(summary.is_of_path for summary in summaries) and all(
        Flag.TOUCH_NOT_OBSERVED in summary.flags for summary in summaries
    )


@dataclass(frozen=True)
class DynamicModulus:
    """The complex modulus at one frequency of the probe's oscillation."""

    stamp_ns: int
    start_ns: int
    site_id: int
    contact_id: int
    modulus: ComplexModulus


@dataclass(frozen=True)
class Failure:
    """An exception that ended a contact and its site."""

    stamp_ns: int  #: of the newest sample
    site_id: int  #: 0: there was none yet
    contact_id: int  #: 0: in the air
    reason: str  #: one line: kind and message
    traceback: str

    def __str__(self) -> str:
        place = f"contact {self.contact_id} of site {self.site_id}" if self.contact_id else "air"
        return f"the estimation failed in {place} ({self.reason}): this site gives no estimate"


Output = TissueState | Classification | ContactSummary | DynamicModulus


def stale(state: TissueState | None, flags: Flag = Flag.NONE) -> TissueState:
    """Return `state` as no longer current, with nothing in it to act on.

    None: there was none yet; the stamp is then 0, and the flags are `flags`.
    """
    if state is None:
        return TissueState(0, Status.STALE, flags, site_id=0, contact_id=0, phase=Phase.NONE)
    return TissueState(
        # A stamp of its own, and before that of any sample to come.
        stamp_ns=state.stamp_ns + 1,
        status=Status.STALE,
        flags=state.flags,
        site_id=state.site_id,
        contact_id=state.contact_id,
        phase=Phase.NONE,
    )


def late(state: TissueState, deadline: float) -> TissueState:
    """Return `state` as it is, or with nothing known if its lag is above a deadline [s].

    Its numbers stay: they describe that earlier time.
    """
    if state.lag <= deadline or state.status in (Status.UNKNOWN, Status.STALE):
        return state
    estimate = state.estimate
    if estimate is not None:
        estimate = estimate._replace(known=ParameterSet.NONE)
    return replace(state, status=Status.LATE, estimate=estimate)


def placed(output: Output, frame: str) -> Output:
    """Return an output with the frame of its position, if it has one."""
    if not isinstance(output, ContactSummary) or output.position is None:
        return output
    return replace(output, position_frame=frame)


def order_source(estimate: Estimate | None, config: EstimatorConfig) -> OrderSource:
    """Return where the alpha of an estimate comes from."""
    if estimate is None:
        return OrderSource.NONE
    if not config.learns_fractional_order:
        return OrderSource.GIVEN
    is_determined = ParameterSet.FRACTIONAL_ORDER in estimate.observable
    is_learned = is_determined and not config.is_order_given
    return OrderSource.LEARNED if is_learned else OrderSource.PRIOR


def estimate_flags(estimate: Estimate | None) -> Flag:
    """Return the flags of an estimate: at an end of the prior, of a wrong alpha."""
    if estimate is None:
        return Flag.NONE
    edge = Flag.AT_PRIOR_LIMIT if estimate.at_edge else Flag.NONE
    return edge | (Flag.ALPHA_PRIOR_CONFLICT if estimate.is_order_contradicted else Flag.NONE)


def failure_of(error: Exception, stamp_ns: int, site_id: int, contact_id: int) -> Failure:
    """Return an exception as a :class:`Failure`."""
    return Failure(
        stamp_ns=stamp_ns,
        site_id=site_id,
        contact_id=contact_id,
        reason=" ".join("".join(traceback.format_exception_only(error)).split()),
        traceback="".join(traceback.format_exception(error)).strip(),
    )
