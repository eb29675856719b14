"""Touch probes (60B8h to 60BDh, IEC 61800-7-201): the position at the edges of an input, or at the index pulse."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

from hilbench.cia402 import objects
from hilbench.cia402.assumed import cell_of
from hilbench.cia402.firmware import Firmware
from hilbench.cia402.switches import index_between_rad
from hilbench.cia402.units import wrap_int32

if TYPE_CHECKING:
    from hilbench.cia402.axis import AxisDevice

# Bits of 60B8h for probe 1; those of probe 2 are eight higher.
ENABLE: Final = 1 << 0
CONTINUOUS: Final = 1 << 1
BY_INDEX: Final = 1 << 2
POSITIVE_EDGE: Final = 1 << 4
NEGATIVE_EDGE: Final = 1 << 5

# Bits of 60B9h for probe 1.
ENABLED: Final = 1 << 0
POSITIVE_STORED: Final = 1 << 1
NEGATIVE_STORED: Final = 1 << 2


class TouchProbes:
    """Both probes of a drive; `update` once a cycle, after the motor's feedback was shown."""

    def __init__(self, device: AxisDevice, firmware: Firmware) -> None:
        cell = partial(cell_of, device, firmware.units)
        self._firmware = firmware
        self._function = cell(objects.TOUCH_PROBE_FUNCTION)
        self._status = cell(objects.TOUCH_PROBE_STATUS)
        self._positions = [cell(index) for index in objects.TOUCH_PROBE_POSITIONS]
        self._position_rad = firmware.port.position_rad
        self._before = 0

    @property
    def idle(self) -> bool:
        """True if neither is in use."""
        return not self._function.value and not self._status.value

    def update(self) -> None:
        """Note the edges that the last cycle has brought."""
        function, status = int(self._function.value), int(self._status.value)
        before_rad, self._position_rad = self._position_rad, self._firmware.port.position_rad
        if not function and not status:
            return
        bits = [self._probe(number, function, status, before_rad) << 8 * number for number in (0, 1)]
        self._status.value = bits[0] | bits[1]
        self._before = function

    def _probe(self, number: int, function: int, status: int, before_rad: float) -> int:
        asked, was_asked, stored = ((word >> 8 * number) & 0xFF for word in (function, self._before, status))
        if not asked & ENABLE:
            return 0
        if not was_asked & ENABLE:
            stored = 0
        for edge, (bit, flag) in enumerate(((POSITIVE_EDGE, POSITIVE_STORED), (NEGATIVE_EDGE, NEGATIVE_STORED))):
            if not asked & bit or (stored & flag and not asked & CONTINUOUS):
                continue
            found = self._edge(number, bool(asked & BY_INDEX), before_rad, rising=edge == 0)
            if found is not None:
                self._positions[2 * number + edge].value = found
                stored |= flag
        return stored | ENABLED

    def _edge(self, number: int, by_index: bool, before_rad: float, *, rising: bool) -> int | None:
        """Position (position units) of an edge since the last cycle; None: there was none."""
        firmware = self._firmware
        if by_index:
            passed_rad = index_between_rad(before_rad, self._position_rad) if rising else None
            if passed_rad is None:
                return None
            return wrap_int32(round(passed_rad / firmware.units.position_rad) + firmware.position_origin)
        if firmware.switches is None:
            return None
        zone = firmware.switches.probes[number]
        before, now = zone.holds(before_rad), zone.holds(self._position_rad)
        return int(firmware.position_actual.value) if before is not now and now is rising else None
