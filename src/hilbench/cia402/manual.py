"""One drive moved by hand, by SDO alone: no SYNC, no PDO, no bench."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

from hilbench.canopen.master import Master
from hilbench.cia402 import objects
from hilbench.cia402.configuration import CONSUMER_HEARTBEAT
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.state_machine import (
    CONTROLWORD_FAULT_RESET,
    STATUS_INTERNAL_LIMIT,
    STATUS_REMOTE,
    STATUS_TARGET_REACHED,
    STATUS_VOLTAGE_ENABLED,
    STATUS_WARNING,
    Command,
    State,
    controlword_towards_disabled,
    controlword_towards_enabled,
    decode_statusword,
)
from hilbench.cia402.units import DriveUnits
from hilbench.errors import BenchFaultError

_STEP_S: Final = 0.02
_FLAGS: Final = {
    STATUS_VOLTAGE_ENABLED: "voltage enabled",
    STATUS_WARNING: "warning",
    STATUS_REMOTE: "remote",
    STATUS_TARGET_REACHED: "target reached",
    STATUS_INTERNAL_LIMIT: "internal limit active",
}
_STOPPED_RAD_S: Final = 0.05
_ABORT_BY_QUICK_STOP: Final = 3


@dataclass(frozen=True)
class DriveStatus:
    """What a drive shows of itself; SI, motor side. None: its EDS lacks the object, or nobody tells its units."""

    statusword: int
    state: str
    flags: list[str]
    mode: int | None
    error_code: int | None
    position_rad: float | None
    velocity_rad_s: float | None
    torque_Nm: float | None


class ManualDrive:
    """A drive on the bus, by its node id; raises BenchFaultError when it does not answer or hangs in a state.

    `units` are needed for motion and for values in SI only.
    """

    def __init__(self, master: Master, node_id: int, name: str, units: DriveUnits | None, time_out_s: float) -> None:
        self._master = master
        self._node_id = node_id
        self._name = name
        self._units = units
        self._time_out_s = time_out_s

    def status(self) -> DriveStatus:
        """Read it."""
        statusword = self._statusword()
        state, units = decode_statusword(statusword), self._units
        return DriveStatus(
            statusword,
            state.label if state is not None else "unknown",
            [text for bit, text in _FLAGS.items() if statusword & bit],
            self._read(objects.MODES_OF_OPERATION_DISPLAY),
            self._read(objects.ERROR_CODE),
            _scaled(self._read(objects.POSITION_ACTUAL_VALUE), units.position_rad if units else None),
            _scaled(self._read(objects.VELOCITY_ACTUAL_VALUE), units.velocity_rad_s if units else None),
            _scaled(self._read(objects.TORQUE_ACTUAL_VALUE), units.torque_Nm if units else None),
        )

    def enable(self) -> None:
        """To OPERATION ENABLED in profile velocity mode, at velocity 0. A fault is not reset on the way."""
        if self._state() is State.FAULT:
            raise self._fault("is in FAULT, expected a drive without one: reset it first")
        self._master.sdo_write(self._node_id, objects.TARGET_VELOCITY, 0)
        self._master.sdo_write(self._node_id, objects.MODES_OF_OPERATION, int(OperationMode.PROFILE_VELOCITY))
        self._go(controlword_towards_enabled, State.OPERATION_ENABLED)

    def disable(self) -> None:
        """To SWITCH ON DISABLED, with the drive's ramp (605Ch). A drive in FAULT stays there, without power."""
        if self._state() is not State.FAULT:
            self._go(controlword_towards_disabled, State.SWITCH_ON_DISABLED)

    def reset(self) -> None:
        """Acknowledge a fault: the rising edge of bit 7."""
        if self._state() is not State.FAULT:
            return
        for controlword in (Command.DISABLE_VOLTAGE.value, CONTROLWORD_FAULT_RESET, Command.DISABLE_VOLTAGE.value):
            self._master.sdo_write(self._node_id, objects.CONTROLWORD, controlword)
        self._go(lambda state: Command.DISABLE_VOLTAGE.value, State.SWITCH_ON_DISABLED)

    @contextmanager
    def watching(self, master_id: int, time_out_ms: int) -> Iterator[None]:
        """Meanwhile the drive stops by quick stop when the master's heartbeat stays away (1016h, 6007h), if it can."""
        wanted = {
            (objects.ABORT_CONNECTION_OPTION_CODE, 0): _ABORT_BY_QUICK_STOP,
            (CONSUMER_HEARTBEAT, 1): master_id << 16 | time_out_ms,
        }
        before = {
            key: self._master.sdo_read(self._node_id, *key) for key in wanted if self._master.has(self._node_id, *key)
        }
        for index, sub in before:
            self._master.sdo_write(self._node_id, index, wanted[(index, sub)], sub)
        try:
            yield
        finally:
            for (index, sub), value in before.items():
                self._master.sdo_write(self._node_id, index, value, sub)

    def move(self, velocity_rad_s: float) -> None:
        """Ramp to a velocity of the motor (6083h, 6084h). Raises BenchFaultError when its units are not known."""
        if self._units is None:
            raise self._fault("does not tell its velocity unit (60A9h), expected it: give units in --config")
        if self._state() is not State.OPERATION_ENABLED:
            raise self._fault(f"left OPERATION ENABLED, statusword {self._statusword():04X}h")
        self._master.sdo_write(
            self._node_id, objects.TARGET_VELOCITY, round(velocity_rad_s / self._units.velocity_rad_s)
        )

    def stop(self) -> None:
        """Velocity 0, and wait until it stands still or the time is out."""
        self.move(0.0)
        deadline_s = time.monotonic() + self._time_out_s
        while abs(self.status().velocity_rad_s or 0.0) > _STOPPED_RAD_S and time.monotonic() < deadline_s:
            time.sleep(_STEP_S)

    def _go(self, controlword: Callable[[State], int], goal: State) -> None:
        deadline_s = time.monotonic() + self._time_out_s
        while (state := self._state()) is not goal:
            if time.monotonic() > deadline_s:
                raise self._fault(f"hung in {state.label} for {self._time_out_s:g} s, wanted {goal.label}")
            self._master.sdo_write(self._node_id, objects.CONTROLWORD, controlword(state))
            time.sleep(_STEP_S)

    def _statusword(self) -> int:
        return int(self._master.sdo_read(self._node_id, objects.STATUSWORD))

    def _state(self) -> State:
        statusword = self._statusword()
        state = decode_statusword(statusword)
        if state is None:
            raise self._fault(f"statusword {statusword:04X}h shows no state that CiA 402 knows")
        return state

    def _read(self, index: int) -> int | None:
        return int(self._master.sdo_read(self._node_id, index)) if self._master.has(self._node_id, index) else None

    def _fault(self, problem: str) -> BenchFaultError:
        return BenchFaultError(f"{self._name} (node {self._node_id}): {problem}")


def _scaled(value: int | None, factor: float | None) -> float | None:
    return None if value is None or factor is None else value * factor


@dataclass
class DeadManKey:
    """A key that must be held: a terminal repeats a held key, and says nothing when it is let go.

    The first repeat comes after `first_s` at the latest, the others every `repeat_s`: whoever is later has let go.
    """

    first_s: float = 0.7
    repeat_s: float = 0.25
    direction: int = 0
    _until_s: float = 0.0

    def pressed(self, direction: int, now_s: float) -> None:
        """A key came: +1 forward, -1 backward, 0 stop."""
        held = direction == self.direction and now_s < self._until_s
        self.direction = direction
        self._until_s = now_s + (self.repeat_s if held else self.first_s)

    def held(self, now_s: float) -> int:
        """The direction that is held; 0 once the key was let go."""
        if now_s >= self._until_s:
            self.direction = 0
        return self.direction
