# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Live tissue parameters for a controller: a reliable number, or at once the reason for none.

>>> feed = TissueFeed(node, "/identifier")                                     # doctest: +SKIP
>>> known = feed.stiffness()                                                   # doctest: +SKIP
>>> gain = bandwidth / known.value if known else safe_gain                     # doctest: +SKIP
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fden_msgs.msg import TissueEstimate
from numpy.typing import ArrayLike
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

from fden_ros.control import LiveTissue, Prediction, Refusal
from fden_ros.core.law import Geometry
from fden_ros.core.outputs import TissueState
from fden_ros.errors import InputError
from fden_ros.parameters import check, read_parameter_file, uncertainty_of
from fden_ros.ros.messages import state_of
from fden_ros.ros.plain_node import plain_node

#: The deadline that the identifier offers; a feed cannot request a shorter one [s].
OFFERED_DEADLINE, OFFERED_LEASE = 0.05, 0.2
#: The age is checked five times per deadline.
_CHECKS_PER_DEADLINE = 5
_SPIN_TIMEOUT = 0.02


class TissueFeed(LiveTissue):
    """The latest estimate with its age; refuses what cannot be relied on.

    The caller of a method learns of a frozen, killed or unreachable identifier no later than the
    deadline, even if no callback could run; DDS reports it by a liveliness lease.

    Parameters
    ----------
    node : Node
        The controller's; its executor must be spun.
    identifier : str
        Name of the identifier node.
    parameters : path or None
        The identifier's parameter file: predictions need the geometry, and their sd includes what
        is not known of tissue and rig.
    geometry : Geometry or None
        The geometry itself, instead of a file; the rig's sds are then the defaults.
    deadline : float
        An estimate older than this is refused [s]; at least 0.05.
    real_time : bool
        The stamps advance with the clock. With false, for bags played at another pace, a delayed
        estimate looks like a fresh one.
    on_loss : callable or None
        Called with the :class:`Refusal` when the reliable estimate is lost.
    on_state : callable or None
        Called with every :class:`TissueState`, whether it may be relied on or not.

    Raises
    ------
    InputError
        If the deadline is shorter than what the identifier offers, or the file cannot be used.
    """

    def __init__(
        self,
        node: Node,
        identifier: str = "/identifier",
        *,
        parameters: str | Path | None = None,
        geometry: Geometry | None = None,
        deadline: float = 0.1,
        real_time: bool = True,
        on_loss: Callable[[Refusal], None] | None = None,
        on_state: Callable[[TissueState], None] | None = None,
    ) -> None:
        if not deadline >= OFFERED_DEADLINE:
            raise InputError(f"deadline is {deadline} s; give at least {OFFERED_DEADLINE} s")
        stated = check({})
        if parameters is not None:
            stated = read_parameter_file(parameters, identifier)
            geometry = stated.geometry.build()
        super().__init__(
            geometry,
            uncertainty=uncertainty_of(stated),
            deadline=deadline,
            real_time=real_time,
            on_loss=on_loss,
        )
        self._node, self._topic, self._on_state = node, f"{identifier}/estimate", on_state
        self._has_lease, self._is_lease_refused = True, False
        self._subscription = self._subscribe()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(deadline / _CHECKS_PER_DEADLINE, self._look, clock=steady)

    def destroy(self) -> None:
        """Stop listening."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_subscription(self._subscription)

    @classmethod
    @contextmanager
    def standalone(cls, identifier: str = "/identifier", **options: Any) -> Iterator[TissueFeed]:
        """Listen in a thread and a ROS context of its own, for a controller without rclpy.

        `options` are those of the class; callbacks run in that thread.
        """
        stop = threading.Event()
        with plain_node("tissue_feed") as (node, executor):
            feed = cls(node, identifier, **options)

            def spin() -> None:
                while not stop.is_set():
                    executor.spin_once(timeout_sec=_SPIN_TIMEOUT)

            thread = threading.Thread(target=spin, name="tissue_feed", daemon=True)
            thread.start()
            try:
                yield feed
            finally:
                stop.set()
                thread.join()

    def predict_force(self, times: ArrayLike, displacements: ArrayLike) -> Prediction | None:
        """Return the force of a plan as :meth:`Predictor.force` does; None: it cannot be known.

        Raises
        ------
        InputError
            If the feed was given no geometry, or the plan has no shape.
        """
        predictor = self.predictor()
        return None if predictor is None else predictor.force(times, displacements)

    def _subscribe(self) -> Any:
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.RELIABLE
        )
        if self._has_lease:
            qos.liveliness = LivelinessPolicy.AUTOMATIC
            qos.liveliness_lease_duration = Duration(seconds=max(self.deadline, OFFERED_LEASE))
        events = SubscriptionEventCallbacks(
            liveliness=lambda event: self.count_publishers(event.alive_count),
            incompatible_qos=self._on_incompatible,
        )
        return self._node.create_subscription(
            TissueEstimate, self._topic, self._on_estimate, qos, event_callbacks=events
        )

    def _on_estimate(self, message: TissueEstimate) -> None:
        state = state_of(message)
        self.add(state)
        if self._on_state is not None:
            self._on_state(state)

    def _on_incompatible(self, event: object) -> None:
        self._is_lease_refused = True

    def _look(self) -> None:
        if self._is_lease_refused and self._has_lease:
            # As from a bag that is played: the age alone is watched.
            self._has_lease = False
            self._node.destroy_subscription(self._subscription)
            self._subscription = self._subscribe()
        self.check()
