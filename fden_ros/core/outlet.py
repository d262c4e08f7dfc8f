# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""Where outputs leave the pipeline, each with what was rejected and measured by then."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace

from fden_ros.core.outputs import ContactSummary, Flag, Output, TissueState
from fden_ros.core.stiffness import MeasuredSlopes


class Outlet:
    """Gives outputs to a listener.

    Parameters
    ----------
    emit : callable
        Called with every output; what it raises is not caught.
    rejected : collections.Counter
        Counts of rejected samples so far.
    """

    def __init__(
        self, emit: Callable[[Output], None], rejected: Counter[str], measured: MeasuredSlopes
    ) -> None:
        self.emit = emit
        self._rejected, self._measured = rejected, measured
        self._raised: Exception | None = None
        self.restart()

    def restart(self) -> None:
        """Tell of no sample that was rejected before."""
        self._told = self._rejected.total()

    def has_raised(self, error: Exception) -> bool:
        """Whether an exception is the listener's own."""
        return error is self._raised

    def put(self, outputs: Iterable[Output]) -> None:
        """Give outputs to the listener, in order."""
        for output in map(self._completed, outputs):
            try:
                self.emit(output)
            except Exception as error:
                self._raised = error
                raise

    def _completed(self, output: Output) -> Output:
        if isinstance(output, ContactSummary):
            return replace(output, measured=self._measured.of(output.contact_id))
        if not isinstance(output, TissueState):
            return output
        if self._rejected.total() != self._told:
            # Samples were rejected since the last state.
            self.restart()
            output = replace(output, flags=output.flags | Flag.INPUT_REJECTED)
        return replace(output, measured=self._measured.newest)
