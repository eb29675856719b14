"""One drive moved by hand, by SDO alone: no SYNC, no PDO, no bench."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import isnan
from typing import Final

from hilbench.canopen.master import Master
from hilbench.cia402 import objects
from hilbench.cia402.axis import object_of
from hilbench.cia402.configuration import CONSUMER_HEARTBEAT, place_of
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.state_machine import (
    CONTROLWORD_FAULT_RESET,
    POWERED,
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
_ACTUAL: Final = (objects.POSITION_ACTUAL_VALUE, objects.VELOCITY_ACTUAL_VALUE, objects.TORQUE_ACTUAL_VALUE)
#: Targets that are 0 before a mode begins to act.
_RESTING_TARGETS: Final = {
    OperationMode.PROFILE_VELOCITY: objects.TARGET_VELOCITY,
    OperationMode.TORQUE: objects.TARGET_TORQUE,
}
_STOPPED_RAD_S: Final = 0.05
_ABORT_BY_QUICK_STOP: Final = 3


@dataclass(frozen=True)
class DriveStatus:
    """Status of a drive; SI, motor side. None: its EDS lacks the object, or its units are not given."""

    statusword: int
    state: str
    flags: list[str]
    mode: int | None
    error_code: int | None
    position_rad: float | None
    velocity_rad_s: float | None
    torque_Nm: float | None
    #: Raw values of the drive: 6064h, 606Ch, 6077h.
    position_units: int | None
    velocity_units: int | None
    torque_units: int | None


class ManualDrive:
    """A drive on the bus, by its node id; raises BenchFaultError when it does not answer or hangs in a state.

    `units` are needed for motion and for values in SI only; `alive` is called while it waits (a heartbeat, say).
    """

    def __init__(
        self,
        master: Master,
        node_id: int,
        name: str,
        units: DriveUnits | None,
        time_out_s: float,
        alive: Callable[[], None] = lambda: None,
        axis: int = 1,
    ) -> None:
        self._master = master
        self._node_id = node_id
        #: For messages.
        self.name = f"{name} ({place_of(node_id, axis)})"
        self._axis = axis
        self.units = units
        self.time_out_s = time_out_s
        self.alive = alive

    def status(self) -> DriveStatus:
        """Read it."""
        statusword = self._statusword()
        state, units = decode_statusword(statusword), self.units
        position, velocity, torque = (self._read(index) for index in _ACTUAL)
        return DriveStatus(
            statusword,
            state.label if state is not None else "unknown",
            [text for bit, text in _FLAGS.items() if statusword & bit],
            self._read(objects.MODES_OF_OPERATION_DISPLAY),
            self._read(objects.ERROR_CODE),
            _scaled(position, units.position_rad if units else None),
            _scaled(velocity, units.velocity_rad_s if units else None),
            _scaled(torque, units.torque_Nm if units else None),
            *(position, velocity, torque),
        )

    def has(self, index: int, sub: int = 0) -> bool:
        """True if its EDS file has an object."""
        return self._master.has(self._node_id, self.object(index), sub)

    def object(self, index: int) -> int:
        """Index at the node of an object of this axis, named as that of the first one."""
        return object_of(self._axis, index)

    def read(self, index: int, sub: int = 0) -> int:
        """A whole number that the drive has."""
        return int(self._master.sdo_read(self._node_id, self.object(index), sub))

    def write(self, index: int, value: int, sub: int = 0) -> None:
        """Write one."""
        self._master.sdo_write(self._node_id, self.object(index), value, sub)

    def enable(self, mode: OperationMode = OperationMode.PROFILE_VELOCITY) -> None:
        """Bring it to OPERATION ENABLED in a profile mode, at standstill. A fault is not reset on the way."""
        if self._state() is State.FAULT:
            raise self.fault("is in FAULT, expected a drive without one: reset it first")
        if mode in _RESTING_TARGETS:
            self.write(_RESTING_TARGETS[mode], 0)
        elif mode is OperationMode.PROFILE_POSITION:
            self.write(objects.TARGET_POSITION, self.read(objects.POSITION_ACTUAL_VALUE))
        self.write(objects.MODES_OF_OPERATION, int(mode))
        self._go(controlword_towards_enabled, State.OPERATION_ENABLED)

    def quick_stop(self) -> None:
        """Bring it to rest by 605Ah and 6085h from any motion; then it is without power (unless in FAULT)."""
        if self._state() in POWERED:
            self.write(objects.CONTROLWORD, Command.QUICK_STOP.value)
            deadline_s = time.monotonic() + self.time_out_s
            while self._state() in POWERED and time.monotonic() < deadline_s:
                if self._statusword() & STATUS_TARGET_REACHED and self._state() is State.QUICK_STOP_ACTIVE:
                    break
                self.pause()
        self.write(objects.CONTROLWORD, Command.DISABLE_VOLTAGE.value)

    def disable(self) -> None:
        """Bring it to SWITCH ON DISABLED, with the drive's ramp (605Ch). In FAULT it stays there, without power."""
        if self._state() is not State.FAULT:
            self._go(controlword_towards_disabled, State.SWITCH_ON_DISABLED)

    def reset(self) -> None:
        """Acknowledge a fault: the rising edge of bit 7."""
        if self._state() is not State.FAULT:
            return
        for controlword in (Command.DISABLE_VOLTAGE.value, CONTROLWORD_FAULT_RESET, Command.DISABLE_VOLTAGE.value):
            self.write(objects.CONTROLWORD, controlword)
        self._go(lambda state: Command.DISABLE_VOLTAGE.value, State.SWITCH_ON_DISABLED, from_fault=True)

    @contextmanager
    def watching(self, master_id: int, time_out_ms: int) -> Iterator[None]:
        """Let the drive quick stop meanwhile when the master's heartbeat stays away (1016h, 6007h), if it can."""
        wanted = {
            (objects.ABORT_CONNECTION_OPTION_CODE, 0): _ABORT_BY_QUICK_STOP,
            (CONSUMER_HEARTBEAT, 1): master_id << 16 | time_out_ms,
        }
        before = {key: self.read(*key) for key in wanted if self.has(*key)}
        for index, sub in before:
            self.write(index, wanted[(index, sub)], sub)
        try:
            yield
        finally:
            for (index, sub), value in before.items():
                self.write(index, value, sub)

    def turn(self, velocity_rad_s: float) -> None:
        """Ramp to a velocity of the motor (6083h, 6084h). Raises BenchFaultError when its units are not known."""
        if self.units is None:
            unit = self.object(objects.SI_UNIT_VELOCITY)
            raise self.fault(f"does not define its velocity unit ({unit:X}h), expected it: give units in --config")
        self.enabled_statusword()
        self.write(objects.TARGET_VELOCITY, round(velocity_rad_s / self.units.velocity_rad_s))

    def enabled_statusword(self) -> int:
        """The statusword of a drive that is still in OPERATION ENABLED. Raises BenchFaultError, with its error code."""
        statusword = self._statusword()
        state = decode_statusword(statusword)
        if state is not State.OPERATION_ENABLED:
            label = "no state of CiA 402" if state is None else state.label
            raise self.fault(f"left OPERATION ENABLED, is in {label}, {self._error_code()}")
        return statusword

    def stop(self) -> None:
        """Command velocity 0, and wait until standstill or the time-out."""
        self.turn(0.0)
        deadline_s = time.monotonic() + self.time_out_s
        while abs(self.status().velocity_rad_s or 0.0) > _STOPPED_RAD_S and time.monotonic() < deadline_s:
            self.pause()

    def _go(self, controlword: Callable[[State], int], goal: State, *, from_fault: bool = False) -> None:
        deadline_s = time.monotonic() + self.time_out_s
        while (state := self._state()) is not goal:
            if state is State.FAULT and not from_fault:
                raise self.fault(f"went into FAULT on its way to {goal.label}, {self._error_code()}")
            if time.monotonic() > deadline_s:
                raise self.fault(f"hung in {state.label} for {self.time_out_s:g} s, wanted {goal.label}")
            self.write(objects.CONTROLWORD, controlword(state))
            self.pause()

    def pause(self) -> None:
        """Wait for a moment, in which it is `alive`."""
        self.alive()
        time.sleep(_STEP_S)

    def _statusword(self) -> int:
        return self.read(objects.STATUSWORD)

    def _state(self) -> State:
        statusword = self._statusword()
        state = decode_statusword(statusword)
        if state is None:
            raise self.fault(f"statusword {statusword:04X}h shows no state that CiA 402 knows")
        return state

    def _error_code(self) -> str:
        code, index = self._read(objects.ERROR_CODE), self.object(objects.ERROR_CODE)
        return f"{index:X}h is not in its EDS" if code is None else f"error code ({index:X}h) {code:04X}h"

    def _read(self, index: int) -> int | None:
        return self.read(index) if self.has(index) else None

    def fault(self, problem: str) -> BenchFaultError:
        """The error of this drive."""
        return BenchFaultError(f"{self.name}: {problem}")


def _scaled(value: int | None, factor: float | None) -> float | None:
    return None if value is None or factor is None or isnan(factor) else value * factor


@dataclass
class DeadManKey:
    """A key that must be held: a terminal repeats a held key, and does not report its release.

    The first repeat comes after `first_s` at the latest, the others every `repeat_s`: a later one means a release.
    """

    first_s: float = 0.7
    repeat_s: float = 0.25
    direction: int = 0
    _until_s: float = 0.0

    def pressed(self, direction: int, now_s: float) -> None:
        """Take a key: +1 forward, -1 backward, 0 stop."""
        held = direction == self.direction and now_s < self._until_s
        self.direction = direction
        self._until_s = now_s + (self.repeat_s if held else self.first_s)

    def held(self, now_s: float) -> int:
        """Direction that is held; 0 once the key was released."""
        if now_s >= self._until_s:
            self.direction = 0
        return self.direction
