"""What the clock says of the SYNCs that a twin hears where nobody paces it: how many cycles lie between them, and by
which cycle they come.

What there is to it is in `canopen.bus_cycle`; here is what a SYNC means to the twin, and what the twin says of it.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import pack
from typing import NamedTuple

from hilbench.canopen.bus_cycle import OTHER_CYCLE, BusCycle
from hilbench.canopen.device import Device
from hilbench.twin.reports import PROFILE_SPECIFIC


class ReceivedFrame(NamedTuple):
    """What the clock says of a SYNC."""

    skipped: int  #: cycles between it and the last in which none came; -1: it is one too many
    cycle_ns: int | None  #: that of SYNC from here on, where it is another one than before
    were_apart: bool  #: whether SYNC came by another cycle until now
    apart: bool  #: whether it does so now, as long as nobody goes by that one


class BusClock:
    """Of a bus whose config says `cycle_s`, by `now_ns`. The virtual I/O `device` and `report` tell of other cycles."""

    def __init__(
        self, cycle_s: float, now_ns: Callable[[], int], device: Device, report: Callable[[str], None]
    ) -> None:
        self._config_ns = round(cycle_s * 1e9)
        self._cycle = BusCycle(self._config_ns, now_ns)
        self._device, self._say = device, report
        self.apart = False  #: SYNC comes by another cycle than is gone by

    def sync_received(self, behind: int) -> ReceivedFrame:
        """A SYNC is here, and `behind` more wait."""
        cycles, other_ns = self._cycle.received(behind), self._cycle.pop_other()
        were_apart, self.apart = self.apart, not self._cycle.in_step
        return ReceivedFrame(cycles - 1, other_ns, were_apart, self.apart)

    def report_period(self, cycle_ns: int) -> None:
        """Say that this cycle is gone by from here on, by EMCY and to people."""
        self._device.clear_emergency(OTHER_CYCLE)
        found, of_config = f"SYNC comes every {cycle_ns * 1e-6:.4g} ms", f"{self._config_ns * 1e-6:.4g} ms"
        if cycle_ns != self._config_ns:
            self._device.emergency(OTHER_CYCLE, PROFILE_SPECIFIC, pack("<fx", cycle_ns * 1e-9))
            self._say(f"{found}, cycle_time_s is {of_config}: the twin goes by SYNC")
        else:
            self._say(f"{found} again, as cycle_time_s says")
