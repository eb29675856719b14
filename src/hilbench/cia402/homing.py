"""Mode 6, homing: the methods of IEC 61800-7-201 (6098h), with the switches of `switches`.

A method looks for an edge: of a limit switch (1, 2, 17, 18), or the left or right edge of the home switch (3 to 14, 19
to 30), crossed in one direction at the low speed 6099h:2; the index pulse that follows counts in methods 1 to 14, the
edge itself in 17 to 30. Methods 33 and 34 take the next index pulse, 35 and 37 the present position.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from enum import Enum
from typing import Final

from hilbench.cia402.firmware import Firmware
from hilbench.cia402.mode import Mode
from hilbench.cia402.state_machine import STATUS_MODE_12, STATUS_MODE_13, STATUS_TARGET_REACHED
from hilbench.cia402.switches import Zone, next_index_rad
from hilbench.plant.motor_port import MotorMode

HOMING_START: Final = 1 << 4  #: controlword bit 4 in homing mode

#: No homing: one that is started fails.
NO_METHOD: Final = 0
#: The present position is the home position.
PRESENT_POSITION: Final = (35, 37)
#: By the index pulse alone, and in which direction.
_INDEX_ONLY: Final = {33: -1, 34: 1}
#: From here on methods are those of 1 to 14 without the index pulse.
_WITHOUT_INDEX: Final = 16
#: Methods by a limit switch, and where that is.
_LIMITS: Final = {1: -1, 2: 1}


class _Edge(Enum):
    LEFT = -1
    RIGHT = 1


#: Methods by the home switch: where it is looked for first, which edge counts, and in which direction it is crossed.
_HOME_SWITCH: Final = {
    3: (1, _Edge.LEFT, -1), 4: (1, _Edge.LEFT, 1), 5: (-1, _Edge.RIGHT, 1), 6: (-1, _Edge.RIGHT, -1),
    7: (1, _Edge.LEFT, -1), 8: (1, _Edge.LEFT, 1), 9: (1, _Edge.RIGHT, -1), 10: (1, _Edge.RIGHT, 1),
    11: (-1, _Edge.RIGHT, 1), 12: (-1, _Edge.RIGHT, -1), 13: (-1, _Edge.LEFT, 1), 14: (-1, _Edge.LEFT, -1),
}  # fmt: skip

#: Methods of a drive that has switches.
WITH_SWITCHES: Final = frozenset(
    {
        *(number + without for number in (*_LIMITS, *_HOME_SWITCH) for without in (0, _WITHOUT_INDEX)),
        *_INDEX_ONLY,
        *PRESENT_POSITION,
    }
)


class _NotFoundError(Exception):
    """The method finds no switch."""


class Homing(Mode):
    """Mode 6: bit 4 of the controlword starts the method in 6098h; where it finds the home position is 607Ch."""

    motor_mode = MotorMode.VELOCITY

    def __init__(self, firmware: Firmware) -> None:
        super().__init__(firmware)
        self._attained = False
        self._error = False
        #: Set points (rad/s) of the method that runs.
        self._search: Iterator[float] | None = None

    def enter(self) -> None:
        """A search that was interrupted is over."""
        self._search = None

    def command(self) -> None:
        """Command the method's motion; hold still without one."""
        self._set(self._wanted_rad_s(), self._firmware.homing_acceleration_rad_s2)

    def _wanted_rad_s(self) -> float:
        if self._search is None:
            return 0.0
        try:
            return next(self._search)
        except StopIteration:
            self._attained = True
        except _NotFoundError:
            self._error = True
        self._search = None
        return 0.0

    def follow_controlword(self, controlword: int, previous: int) -> None:
        """Start on the rising edge of bit 4, end when it falls; a homing of a moving motor ends in the homing error."""
        if controlword & ~previous & HOMING_START:
            self._start(int(self._firmware.homing_method.value))
        elif not controlword & HOMING_START:
            self._search = None

    def _start(self, method: int) -> None:
        firmware = self._firmware
        self._attained = self._error = False
        if abs(firmware.port.velocity_rad_s) > firmware.standstill_rad_s:
            self._error = True
        elif method in PRESENT_POSITION:
            self._attained = True
            firmware.set_home(int(firmware.home_offset.value))
        elif firmware.switches is None or method not in WITH_SWITCHES:
            self._error = True
        else:
            self._search = self._procedure(method)

    def status(self, dt_s: float) -> int:
        """Statusword bits: not started 10; runs none; attained 12, with 10 once the motor rests; error 13, likewise."""
        moving = abs(self._firmware.port.velocity_rad_s) > self._firmware.standstill_rad_s
        if self._search is not None:
            return 0
        reached = 0 if moving and (self._error or self._attained) else STATUS_TARGET_REACHED
        if self._error:
            return STATUS_MODE_13 | reached
        return reached | (STATUS_MODE_12 if self._attained else 0)

    # --- the methods -------------------------------------------------------------------------------------------------

    def _procedure(self, method: int) -> Iterator[float]:
        with_index = method <= _WITHOUT_INDEX or method in _INDEX_ONLY
        kind = method if method <= _WITHOUT_INDEX or method in _INDEX_ONLY else method - _WITHOUT_INDEX
        if kind in _INDEX_ONLY:
            direction = _INDEX_ONLY[kind]
        elif kind in _LIMITS:
            direction = -_LIMITS[kind]
            yield from self._to_limit(-direction)
        else:
            first, edge, direction = _HOME_SWITCH[kind]
            yield from self._to_home_switch(first)
            yield from self._over_edge(edge, direction)
        firmware = self._firmware
        if not with_index:
            firmware.set_home(int(firmware.home_offset.value))
            return
        index_rad = next_index_rad(self._position_rad, direction)
        slow = direction * firmware.homing_zero_speed_rad_s
        yield from self._while(lambda: (index_rad - self._position_rad) * direction > 0.0, slow)
        firmware.set_home(int(firmware.home_offset.value), at_count=round(index_rad / firmware.units.position_rad))

    def _to_limit(self, side: int) -> Iterator[float]:
        """Onto the limit switch on that side at 6099h:1, and off it again at 6099h:2."""
        firmware, zone = self._firmware, self._limit_zone(side)
        fast = side * firmware.homing_switch_speed_rad_s
        yield from self._while(lambda: not zone.holds(self._position_rad), fast, to_limit=True)
        yield from self._while(lambda: zone.holds(self._position_rad), -side * firmware.homing_zero_speed_rad_s)

    def _to_home_switch(self, first: int) -> Iterator[float]:
        """Move onto the home switch; a limit switch on the way reverses, a second one is an error."""
        home, fast = self._home_zone, self._firmware.homing_switch_speed_rad_s
        for side in (first, -first):
            limit = self._limit_zone(side)
            yield from self._while(
                lambda limit=limit: not home.holds(self._position_rad) and not limit.holds(self._position_rad),  # type: ignore[misc]
                side * fast,
            )
            if home.holds(self._position_rad):
                return
        raise _NotFoundError

    def _over_edge(self, edge: _Edge, direction: int) -> Iterator[float]:
        """Move from the home switch over one of its edges in that direction."""
        home, slow = self._home_zone, self._firmware.homing_zero_speed_rad_s
        yield from self._while(lambda: home.holds(self._position_rad), edge.value * slow)
        if direction != edge.value:
            yield from self._while(lambda: not home.holds(self._position_rad), direction * slow)

    def _while(self, continues: Callable[[], bool], velocity_rad_s: float, to_limit: bool = False) -> Iterator[float]:
        """Move at that speed while `continues`; a limit switch is an error, unless `to_limit` looks for it."""
        while continues():
            side = 1 if velocity_rad_s > 0.0 else -1
            if not to_limit and self._limit_zone(side).holds(self._position_rad):
                raise _NotFoundError
            yield velocity_rad_s

    @property
    def _position_rad(self) -> float:
        return self._firmware.port.position_rad

    @property
    def _home_zone(self) -> Zone:
        assert self._firmware.switches is not None, "a method by switches is not started without"
        return self._firmware.switches.home

    def _limit_zone(self, side: int) -> Zone:
        switches = self._firmware.switches
        assert switches is not None, "a method by switches is not started without"
        return switches.positive_limit if side > 0 else switches.negative_limit
