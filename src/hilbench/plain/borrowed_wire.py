"""The wire of the embedded bus, for a bench whose cycles are plain: see `can.loan`."""

from __future__ import annotations

from hilbench.can.embedded import EmbeddedLink
from hilbench.can.loan import NO_WIRE, Loan

#: Cycles after which it is asked anew, twice as many each time that there was nothing, up to the longest.
_LOOK_AGAIN, _LONGEST_PAUSE = 64, 1024


class BorrowedWire:
    """The wire for who sends and hears by cycles: asked for now and then where it is not there."""

    def __init__(self, link: EmbeddedLink) -> None:
        self._link = link
        self._loan: Loan | None = None
        self._wait, self._pause = 0, _LOOK_AGAIN  # cycles
        self.table = NO_WIRE  #: for `loan_kernel`

    def look(self) -> list[bytes]:
        """Between two cycles: packets that have come while the wire was asked for. Raises BusError."""
        self._wait -= 1
        if self._wait > 0:
            return []
        if self._loan is not None and self._loan.lasts:
            self._wait = self._pause = _LOOK_AGAIN
            return []
        self._wait, self._pause = self._pause, min(2 * self._pause, _LONGEST_PAUSE)
        self._loan, came = self._link.borrow()
        self.table = NO_WIRE if self._loan is None else self._loan.table
        return came
