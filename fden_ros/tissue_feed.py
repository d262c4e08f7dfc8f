# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Live tissue parameters for a controller: trust a number, or know at once that it cannot be.

>>> feed = TissueFeed(node, "/identifier")                                     # doctest: +SKIP
>>> reading = feed.reading()                                                   # doctest: +SKIP
>>> gain = bandwidth / reading.stiffness(0.1)[0] if reading else safe_gain     # doctest: +SKIP
"""

from __future__ import annotations

import threading
import time
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

from fden_ros.control import LiveTissue, Prediction, Predictor, Reading, Refusal
from fden_ros.core.estimation import ParameterSet
from fden_ros.core.law import Geometry
from fden_ros.core.measured_stiffness import BothWays
from fden_ros.core.outputs import TissueState
from fden_ros.errors import InputError
from fden_ros.parameters import check, read_parameter_file, uncertainty_of
from fden_ros.ros.messages import state_of
from fden_ros.ros.plain_node import plain_node

#: What the identifier offers; a feed cannot ask for less.
OFFERED_DEADLINE = 0.05
OFFERED_LEASE = 0.2
#: The estimates are looked at five times per deadline, beside what DDS itself reports.
_CHECKS_PER_DEADLINE = 5
_SPIN_TIMEOUT = 0.02


class TissueFeed:
    """The latest estimate with its age; refuses what cannot be relied on.

    Subscribes with a deadline and a liveliness lease, so that DDS reports a frozen, killed or
    unreachable identifier by itself; whoever asks knows it no later than the deadline, even if no
    callback could run. Calls from several threads are safe.

    Parameters
    ----------
    node : Node
        The controller's; its executor must be spun.
    identifier : str
        Name of the identifier node.
    parameters : path or None
        The identifier's parameter file: predictions need the geometry, and what is not known of
        tissue and rig counts in their deviations.
    geometry : Geometry or None
        The geometry itself, instead of a file; what is not known counts by its defaults.
    deadline : float
        An estimate older than this is refused [s]; at least 0.05.
    required : ParameterSet
        What must have converged: G and Gn, or G alone; see :class:`LiveTissue`.
    change : float
        `on_change` is called when the apparent stiffness has moved by this part.
    real_time : bool
        False where a bag is played at another pace; see :class:`LiveTissue`.
    on_change : callable or None
        Called with a :class:`Reading` when there is one again and when it has changed.
    on_loss : callable or None
        Called with the :class:`Refusal` when there is none to rely on any more.
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
        required: ParameterSet = ParameterSet.STIFFNESS,
        change: float = 0.05,
        real_time: bool = True,
        on_change: Callable[[Reading], None] | None = None,
        on_loss: Callable[[Refusal], None] | None = None,
        on_state: Callable[[TissueState], None] | None = None,
    ) -> None:
        if not deadline >= OFFERED_DEADLINE:
            raise InputError(
                f"deadline is {deadline} s; the identifier promises an estimate every "
                f"{OFFERED_DEADLINE} s, so it must be at least that"
            )
        checked = check({})
        if parameters is not None:
            checked = read_parameter_file(parameters, identifier)
            geometry = checked.geometry.build()
        self._knows_geometry = geometry is not None
        self._node = node
        self._topic = f"{identifier}/estimate"
        self._deadline = deadline
        self._on_state = on_state
        self._lock = threading.RLock()
        self._live = LiveTissue(
            geometry,
            uncertainty=uncertainty_of(checked),
            deadline=deadline,
            required=required,
            change=change,
            real_time=real_time,
            on_change=on_change,
            on_loss=on_loss,
        )
        self._promised, self._is_plain = True, False
        self._subscription = self._subscribe()
        self._timer = node.create_timer(
            deadline / _CHECKS_PER_DEADLINE,
            self._check,
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )

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

    # What a controller asks

    def reading(self) -> Reading | None:
        """Return the latest estimate if it may be relied on, else None."""
        with self._lock:
            return self._live.reading(time.monotonic())

    def refusal(self) -> Refusal | None:
        """Return why there is no estimate to rely on; None if there is one."""
        with self._lock:
            return self._live.refusal(time.monotonic())

    def stiffness(self, time_scale: float = 0.1) -> tuple[float, float] | None:
        """Return dF/dd for a motion of `time_scale` seconds and its deviation [N/m], or None.

        Of tissue of another law, MODEL_MISMATCH, it is that law's.
        """
        with self._lock:
            return self._live.stiffness(time.monotonic(), time_scale)

    def measured(self) -> BothWays:
        """Return the slopes of force over displacement of the newest loading and unloading.

        As they are measured: no law, and no convergence, touch or time scale is asked for; each
        has its deviation, depth and stamp. None of both while no message comes in time.
        """
        with self._lock:
            return self._live.measured(time.monotonic())

    def predict_force(self, times: ArrayLike, displacements: ArrayLike) -> Prediction | None:
        """Return the force of a planned motion, or None if that cannot be known.

        Parameters
        ----------
        times : array_like, shape (n,)
            Seconds from the latest estimate, increasing.
        displacements : array_like, shape (n,)
            Distance further into the tissue by then [m], linear in between.

        Raises
        ------
        InputError
            If the feed was given no geometry.
        """
        predictor = self._predictor()
        return None if predictor is None else predictor.force(times, displacements)

    @property
    def restarts(self) -> int:
        """How often the identifier began anew: its memory of the tissue is gone then."""
        with self._lock:
            return self._live.restarts

    # Inside

    def _predictor(self) -> Predictor | None:
        if not self._knows_geometry:
            raise InputError(
                "a prediction needs the probe's geometry: give the feed parameters=, the "
                "identifier's file, or geometry="
            )
        with self._lock:
            return self._live.predictor(time.monotonic())

    def _subscribe(self) -> Any:
        qos = QoSProfile(
            history=HistoryPolicy.KEEP_LAST, depth=100, reliability=ReliabilityPolicy.RELIABLE
        )
        if not self._promised:
            return self._node.create_subscription(
                TissueEstimate, self._topic, self._on_estimate, qos
            )
        qos.deadline = Duration(seconds=self._deadline)
        qos.liveliness = LivelinessPolicy.AUTOMATIC
        qos.liveliness_lease_duration = Duration(seconds=max(self._deadline, OFFERED_LEASE))
        events = SubscriptionEventCallbacks(
            deadline=lambda _: self._on_miss(),
            liveliness=lambda event: None if event.alive_count else self._on_loss(),
            incompatible_qos=lambda _: self._on_incompatible(),
        )
        return self._node.create_subscription(
            TissueEstimate, self._topic, self._on_estimate, qos, event_callbacks=events
        )

    def _on_estimate(self, message: TissueEstimate) -> None:
        state = state_of(message)
        with self._lock:
            self._live.add(state, time.monotonic())
        if self._on_state is not None:
            self._on_state(state)

    def _on_miss(self) -> None:
        with self._lock:
            self._live.miss(time.monotonic())

    def _on_loss(self) -> None:
        with self._lock:
            self._live.lose(time.monotonic())

    def _on_incompatible(self) -> None:
        self._promised = False

    def _check(self) -> None:
        if not self._promised and not self._is_plain:
            self._listen_without_promise()
        with self._lock:
            self._live.check(time.monotonic())

    def _listen_without_promise(self) -> None:
        """Hear an estimate whose publisher promises a longer deadline or none.

        The ages are watched as ever.
        """
        self._is_plain = True
        self._node.get_logger().warning(
            f"{self._topic} is published without a deadline as short as {self._deadline:g} s: "
            "its age alone is watched"
        )
        self._node.destroy_subscription(self._subscription)
        self._subscription = self._subscribe()
