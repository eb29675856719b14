"""Clock check of received SYNCs in real time: elapsed cycles between them, and their period.

The method is in `canopen.bus_cycle`; here is its meaning for the twin, and the twin's report of it.
"""

from __future__ import annotations

from collections.abc import Callable
from struct import pack
from typing import NamedTuple

from hilbench.canopen.bus_cycle import OTHER_CYCLE, BusCycle
from hilbench.canopen.device import Device
from hilbench.twin.reports import PROFILE_SPECIFIC


class SyncArrival(NamedTuple):
    """Clock check of a received SYNC."""

    skipped: int  #: cycles without SYNC since the last; -1: it is one too many
    cycle_ns: int | None  #: new SYNC period, if it has changed
    were_apart: bool  #: SYNC came with another period until now
    apart: bool  #: it does so now, and that period is not yet used


class BusClock:
    """Clock of a bus with the configured `cycle_s`, by `now_ns`. `device` and `report` publish another period."""

    def __init__(
        self, cycle_s: float, now_ns: Callable[[], int], device: Device, report: Callable[[str], None]
    ) -> None:
        self._config_ns = round(cycle_s * 1e9)
        self._cycle = BusCycle(self._config_ns, now_ns)
        self._device, self._say = device, report
        self.apart = False  #: SYNC comes with another period than the one in use

    def sync_received(self, behind: int) -> SyncArrival:
        """Check a received SYNC, with `behind` more waiting."""
        cycles, other_ns = self._cycle.received(behind), self._cycle.pop_other()
        were_apart, self.apart = self.apart, not self._cycle.in_step
        return SyncArrival(cycles - 1, other_ns, were_apart, self.apart)

    def report_period(self, cycle_ns: int) -> None:
        """Report the period in use from here on, by EMCY and to the user."""
        self._device.clear_emergency(OTHER_CYCLE)
        found, of_config = f"SYNC comes every {cycle_ns * 1e-6:.4g} ms", f"{self._config_ns * 1e-6:.4g} ms"
        if cycle_ns != self._config_ns:
            self._device.emergency(OTHER_CYCLE, PROFILE_SPECIFIC, pack("<fx", cycle_ns * 1e-9))
            self._say(f"{found}, cycle_time_s is {of_config}: the twin goes by SYNC")
        else:
            self._say(f"{found} again, as cycle_time_s says")
