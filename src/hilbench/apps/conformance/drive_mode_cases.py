"""Modes of operation and limits of CiA 402: what 6502h promises, and short motions of a turn at most."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import pi
from typing import Final

from hilbench.apps.conformance.dut import DeviceUnderTest, taken_text
from hilbench.apps.conformance.power import (
    SLOW_RAMP_S,
    actual_velocity,
    bring,
    choose,
    command,
    expect_state,
    needs_drive,
    needs_mode,
    speed,
    statusword,
    supported,
    switch_off,
    time_to_rest,
    turn,
    units,
    wait,
)
from hilbench.apps.conformance.record import NotApplicableError
from hilbench.cia402 import objects
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.state_machine import (
    CONTROLWORD_HALT,
    STATUS_MODE_12,
    STATUS_MODE_13,
    STATUS_TARGET_REACHED,
    Command,
    State,
)

_ENABLED: Final = Command.ENABLE_OPERATION.value
_START: Final = 1 << 4  #: controlword: new set-point, or homing begins
_PRESENT_POSITION: Final = (37, 35)
_SHOWN_S: Final = 1.0
_TOLERATED: Final = 1.1
_MOTION_S: Final = 10.0
_STEEP_RAMP_S: Final = 0.01  #: from rest to 60 rpm: shorter than a position loop of 40 1/s settles


def _needs_modes(dut: DeviceUnderTest) -> None:
    needs_drive(dut)
    dut.needs_to_write((objects.MODES_OF_OPERATION, 0))
    dut.needs((objects.SUPPORTED_DRIVE_MODES, 0), (objects.MODES_OF_OPERATION_DISPLAY, 0))


def each_mode(dut: DeviceUnderTest) -> None:
    """Without power."""
    _needs_modes(dut)
    for mode in supported(dut):
        dut.write(objects.MODES_OF_OPERATION, 0, int(mode))
        wait(dut, lambda mode=mode: dut.value(objects.MODES_OF_OPERATION_DISPLAY) == mode, _SHOWN_S)  # type: ignore[misc]
        dut.reads(f"6061h after 6060h = {int(mode)}", objects.MODES_OF_OPERATION_DISPLAY, 0, int(mode))


def other_mode(dut: DeviceUnderTest) -> None:
    """Refused, or never shown."""
    _needs_modes(dut)
    there = supported(dut)
    before = dut.value(objects.MODES_OF_OPERATION_DISPLAY)
    absent = [mode for mode in OperationMode if mode and mode not in there]
    for mode in [int(mode) for mode in absent] or [99]:
        answer = dut.try_to_write(objects.MODES_OF_OPERATION, 0, bytes((mode,)))
        dut.wait(0.1)
        shown = dut.value(objects.MODES_OF_OPERATION_DISPLAY)
        ok = answer != b"" or shown != mode
        seen = f"taken, 6061h is {shown}" if answer == b"" else taken_text(answer)
        dut.check(f"{mode} to 6060h", f"refused, or 6061h stays {before}", seen, ok)


def _turning(dut: DeviceUnderTest) -> None:
    needs_drive(dut)
    dut.needs_motion("turns the motor")


def _bit(dut: DeviceUnderTest, what: str, bit: int, set_: bool, duration_s: float = 1.0) -> bool:
    """Expect a bit of the statusword within a time."""
    came = wait(dut, lambda: bool(statusword(dut) & bit) is set_, duration_s) is not None
    number = bit.bit_length() - 1
    return dut.check(what, f"statusword bit {number} {'set' if set_ else 'clear'}", f"{statusword(dut):04X}h", came)


def profile_position(dut: DeviceUnderTest) -> None:
    """A quarter of a turn, and back; then halted."""
    _turning(dut)
    dut.needs((objects.TARGET_POSITION, 0), (objects.POSITION_ACTUAL_VALUE, 0))
    needs_mode(dut, OperationMode.PROFILE_POSITION)
    at = speed(dut)
    if dut.eds.can_write(objects.PROFILE_VELOCITY):
        dut.write(objects.PROFILE_VELOCITY, 0, at.velocity)
    turn_units = round(2.0 * pi / at.units.position_rad)
    bring(dut, State.OPERATION_ENABLED)
    choose(dut, OperationMode.PROFILE_POSITION)
    begin = dut.signed(objects.POSITION_ACTUAL_VALUE)
    for target in (begin + turn_units // 4, begin):
        _set_point(dut, target)
        _bit(dut, f"set-point {target}: target reached", STATUS_TARGET_REACHED, set_=True, duration_s=_MOTION_S)
        found = dut.signed(objects.POSITION_ACTUAL_VALUE)
        near = abs(found - target) <= max(2, turn_units // 100)
        dut.check(f"position after set-point {target}", f"{target} to 1 % of a turn", str(found), near)
    _set_point(dut, begin + turn_units)
    wait(dut, lambda: abs(actual_velocity(dut)) > 0.5 * at.velocity, SLOW_RAMP_S)
    command(dut, _ENABLED | CONTROLWORD_HALT)
    taken_s = time_to_rest(dut, at.velocity)
    dut.check("halt", "at rest", "at rest" if taken_s is not None else "turns", taken_s is not None)
    _bit(dut, "halt: target reached at standstill", STATUS_TARGET_REACHED, set_=True)
    switch_off(dut)


def _set_point(dut: DeviceUnderTest, target: int) -> None:
    """The handshake: bit 4, acknowledged by bit 12, and both taken back."""
    dut.write(objects.TARGET_POSITION, 0, target)
    command(dut, _ENABLED)
    command(dut, _ENABLED | _START)
    dut.must(_bit(dut, f"new set-point {target}: acknowledged", STATUS_MODE_12, set_=True))
    command(dut, _ENABLED)
    _bit(dut, "bit 4 taken back: acknowledgement too", STATUS_MODE_12, set_=False, duration_s=_MOTION_S)


def profile_velocity(dut: DeviceUnderTest) -> None:
    """At speed bit 10, at rest bit 12."""
    _turning(dut)
    needs_mode(dut, OperationMode.PROFILE_VELOCITY)
    at = speed(dut)
    turn(dut, at.velocity)
    _bit(dut, "at speed: target reached", STATUS_TARGET_REACHED, set_=True, duration_s=2.0)
    _bit(dut, "at speed: not at rest", STATUS_MODE_12, set_=False)
    dut.write(objects.TARGET_VELOCITY, 0, 0)
    _bit(dut, "at rest: speed 0", STATUS_MODE_12, set_=True, duration_s=5.0 * SLOW_RAMP_S)
    dut.write(objects.TARGET_VELOCITY, 0, -at.velocity)
    turned = wait(dut, lambda: actual_velocity(dut) <= -0.8 * at.velocity, 5.0 * SLOW_RAMP_S)
    dut.check("backward", f"{-at.velocity} (606Ch)", str(actual_velocity(dut)), turned is not None)
    command(dut, _ENABLED | CONTROLWORD_HALT)
    taken_s = time_to_rest(dut, at.velocity)
    dut.check("halt", "at rest", "at rest" if taken_s is not None else "turns", taken_s is not None)
    switch_off(dut)


def profile_torque(dut: DeviceUnderTest) -> None:
    """Enabled with torque 0: nothing turns, and the target is reached."""
    needs_drive(dut)
    dut.needs_motion("switches the power stage on")
    dut.needs_to_write((objects.TARGET_TORQUE, 0))
    needs_mode(dut, OperationMode.TORQUE)
    dut.write(objects.TARGET_TORQUE, 0, 0)
    bring(dut, State.OPERATION_ENABLED)
    choose(dut, OperationMode.TORQUE)
    _bit(dut, "torque 0: target reached", STATUS_TARGET_REACHED, set_=True, duration_s=2.0)
    switch_off(dut)


def homing(dut: DeviceUnderTest) -> None:
    """Methods 37 and 35 move nothing: the present position becomes the home offset."""
    needs_drive(dut)
    dut.needs_motion("switches the power stage on, and moves the position's zero")
    dut.needs_to_write((objects.HOMING_METHOD, 0))
    needs_mode(dut, OperationMode.HOMING)
    index = objects.HOMING_METHOD
    method = next((m for m in _PRESENT_POSITION if dut.try_to_write(index, 0, bytes((m,))) == b""), None)
    if method is None:
        raise NotApplicableError("6098h takes neither 37 nor 35")
    bring(dut, State.OPERATION_ENABLED)
    choose(dut, OperationMode.HOMING)
    command(dut, _ENABLED)
    command(dut, _ENABLED | _START)
    _bit(dut, f"method {method}: homing attained", STATUS_MODE_12, set_=True)
    _bit(dut, f"method {method}: target reached", STATUS_TARGET_REACHED, set_=True)
    _bit(dut, f"method {method}: no homing error", STATUS_MODE_13, set_=False)
    offset = dut.signed(objects.HOME_OFFSET) if dut.eds.has(objects.HOME_OFFSET) else 0
    found = dut.signed(objects.POSITION_ACTUAL_VALUE)
    near = max(5, round(2.0 * pi / units(dut).position_rad) // 1000)
    dut.check("position", f"{offset}, the home offset 607Ch, to {near}", str(found), abs(found - offset) <= near)
    switch_off(dut)


# -- limits ----------------------------------------------------------------------------------------------------


def software_limits(dut: DeviceUnderTest) -> None:
    """A set-point beyond 607Dh is refused, or the drive stays within."""
    _turning(dut)
    limit = objects.SOFTWARE_POSITION_LIMIT
    dut.needs_to_write((limit, 1), (limit, 2))
    needs_mode(dut, OperationMode.PROFILE_POSITION)
    at = speed(dut)
    if dut.eds.can_write(objects.PROFILE_VELOCITY):
        dut.write(objects.PROFILE_VELOCITY, 0, at.velocity)
    turn_units = round(2.0 * pi / at.units.position_rad)
    begin = dut.signed(objects.POSITION_ACTUAL_VALUE)
    dut.write(limit, 1, begin - turn_units // 4)
    dut.write(limit, 2, begin + turn_units // 4)
    bring(dut, State.OPERATION_ENABLED)
    choose(dut, OperationMode.PROFILE_POSITION)
    answer = dut.try_to_write(
        objects.TARGET_POSITION, 0, dut.data_of(objects.TARGET_POSITION, 0, begin + turn_units // 2)
    )
    if answer != b"":
        dut.check("set-point beyond 607Dh:2", "refused, or not reached", taken_text(answer), answer is not None)
    else:
        command(dut, _ENABLED)
        command(dut, _ENABLED | _START)
        dut.wait(2.0)
        found = dut.signed(objects.POSITION_ACTUAL_VALUE)
        furthest = begin + turn_units // 4 + turn_units // 100 + 2
        dut.check("half a turn, limit at a quarter", f"position up to {furthest}", str(found), found <= furthest)
    switch_off(dut)


def velocity_limits(dut: DeviceUnderTest) -> None:
    """Half the speed is the limit."""
    _turning(dut)
    needs_mode(dut, OperationMode.PROFILE_VELOCITY)
    at = speed(dut)
    there = [i for i in (objects.MAX_PROFILE_VELOCITY, objects.MAX_MOTOR_SPEED) if dut.eds.can_write(i)]
    if not there:
        raise NotApplicableError("neither 607Fh nor 6080h can be written by the EDS file")
    for index in there:
        before = dut.value(index)
        limit = at.velocity // 2
        dut.write(index, 0, limit if index == objects.MAX_PROFILE_VELOCITY else 30)
        bring(dut, State.OPERATION_ENABLED)
        choose(dut, OperationMode.PROFILE_VELOCITY)
        answer = dut.try_to_write(objects.TARGET_VELOCITY, 0, dut.data_of(objects.TARGET_VELOCITY, 0, at.velocity))
        dut.wait(2.0 * SLOW_RAMP_S)
        found = abs(actual_velocity(dut))
        most = round(_TOLERATED * limit) + 1
        seen = f"{found} (606Ch)" if answer == b"" else taken_text(answer)
        dut.check(f"twice the limit {index:04X}h", f"{most} at most", seen, found <= most)
        switch_off(dut)
        dut.write(index, 0, before)


def following_error(dut: DeviceUnderTest) -> None:
    """A window of one unit is left as soon as it turns: at a ramp that no loop follows within that."""
    _turning(dut)
    dut.needs_to_write((objects.FOLLOWING_ERROR_WINDOW, 0))
    needs_mode(dut, OperationMode.PROFILE_POSITION)
    at = speed(dut)
    if dut.eds.can_write(objects.PROFILE_VELOCITY):
        dut.write(objects.PROFILE_VELOCITY, 0, at.velocity)
    if dut.eds.can_write(objects.PROFILE_ACCELERATION):
        dut.write(objects.PROFILE_ACCELERATION, 0, round(at.velocity / _STEEP_RAMP_S))
    if dut.eds.can_write(objects.FOLLOWING_ERROR_TIME_OUT):
        dut.write(objects.FOLLOWING_ERROR_TIME_OUT, 0, 0)
    turn_units = round(2.0 * pi / at.units.position_rad)
    begin = dut.signed(objects.POSITION_ACTUAL_VALUE)
    bring(dut, State.OPERATION_ENABLED)
    choose(dut, OperationMode.PROFILE_POSITION)
    dut.write(objects.FOLLOWING_ERROR_WINDOW, 0, 1)
    dut.write(objects.TARGET_POSITION, 0, begin + turn_units)
    command(dut, _ENABLED)
    command(dut, _ENABLED | _START)
    expect_state(dut, "6065h = 1, a motion of a turn", State.FAULT)
    if dut.eds.has(objects.ERROR_CODE):
        dut.reads("error code 603Fh", objects.ERROR_CODE, 0, 0x8611)
    dut.write(objects.FOLLOWING_ERROR_WINDOW, 0, 0xFFFF_FFFF)
    switch_off(dut)


CASES: Final[Mapping[str, Callable[[DeviceUnderTest], None]]] = {
    "Modes 1": each_mode,
    "Modes 2": other_mode,
    "Modes 3": profile_position,
    "Modes 4": profile_velocity,
    "Modes 5": profile_torque,
    "Modes 6": homing,
    "Limits 1": software_limits,
    "Limits 2": velocity_limits,
    "Limits 3": following_error,
}
