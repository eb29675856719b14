"""Actions of cases of CiA 402 about modes of operation and limits: what 6502h promises, motions of a turn at most."""

from __future__ import annotations

from math import pi
from typing import Final

from hilbench.apps.conformance.actions import action
from hilbench.apps.conformance.dut import DeviceUnderTest, taken_text
from hilbench.apps.conformance.power import (
    SLOW_RAMP_S,
    actual_velocity,
    command,
    enable,
    expect_state,
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
from hilbench.apps.conformance.steps import write
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


@action
def each_mode(dut: DeviceUnderTest) -> None:
    """Without power."""
    for mode in supported(dut):
        dut.write(objects.MODES_OF_OPERATION, 0, int(mode))
        wait(dut, lambda mode=mode: dut.value(objects.MODES_OF_OPERATION_DISPLAY) == mode, _SHOWN_S)  # type: ignore[misc]
        dut.reads(f"6061h after 6060h = {int(mode)}", objects.MODES_OF_OPERATION_DISPLAY, 0, int(mode))


@action
def other_mode(dut: DeviceUnderTest) -> None:
    """Refused, or never shown."""
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


@action
def status_bit(dut: DeviceUnderTest, what: str, bit: int, set_: bool = True, duration_s: float = 1.0) -> bool:
    """Expect a bit of the statusword within a time."""
    came = wait(dut, lambda: bool(statusword(dut) & bit) is set_, duration_s) is not None
    number = bit.bit_length() - 1
    return dut.check(what, f"statusword bit {number} {'set' if set_ else 'clear'}", f"{statusword(dut):04X}h", came)


@action
def profile_position(dut: DeviceUnderTest) -> None:
    """A quarter of a turn, and back; then halted."""
    at = speed(dut)
    write(dut, {(objects.PROFILE_VELOCITY, 0): at.velocity})
    turn_units = round(2.0 * pi / at.units.position_rad)
    enable(dut, OperationMode.PROFILE_POSITION)
    begin = dut.signed(objects.POSITION_ACTUAL_VALUE)
    for target in (begin + turn_units // 4, begin):
        _set_point(dut, target)
        status_bit(dut, f"set-point {target}: target reached", STATUS_TARGET_REACHED, duration_s=_MOTION_S)
        found = dut.signed(objects.POSITION_ACTUAL_VALUE)
        near = abs(found - target) <= max(2, turn_units // 100)
        dut.check(f"position after set-point {target}", f"{target} to 1 % of a turn", str(found), near)
    _set_point(dut, begin + turn_units)
    wait(dut, lambda: abs(actual_velocity(dut)) > 0.5 * at.velocity, SLOW_RAMP_S)
    _halt(dut, at.velocity)
    status_bit(dut, "halt: target reached at standstill", STATUS_TARGET_REACHED)
    switch_off(dut)


def _halt(dut: DeviceUnderTest, velocity: int) -> None:
    command(dut, _ENABLED | CONTROLWORD_HALT)
    stood = time_to_rest(dut, velocity) is not None
    dut.check("halt", "at rest", "at rest" if stood else "turns", stood)


def _set_point(dut: DeviceUnderTest, target: int) -> None:
    """The handshake: bit 4, acknowledged by bit 12, and both taken back."""
    dut.write(objects.TARGET_POSITION, 0, target)
    command(dut, _ENABLED)
    command(dut, _ENABLED | _START)
    dut.must(status_bit(dut, f"new set-point {target}: acknowledged", STATUS_MODE_12))
    command(dut, _ENABLED)
    status_bit(dut, "bit 4 taken back: acknowledgement too", STATUS_MODE_12, set_=False, duration_s=_MOTION_S)


@action
def profile_velocity(dut: DeviceUnderTest) -> None:
    """At speed bit 10, at rest bit 12."""
    at = speed(dut)
    turn(dut, at.velocity)
    status_bit(dut, "at speed: target reached", STATUS_TARGET_REACHED, duration_s=2.0)
    status_bit(dut, "at speed: not at rest", STATUS_MODE_12, set_=False)
    dut.write(objects.TARGET_VELOCITY, 0, 0)
    status_bit(dut, "at rest: speed 0", STATUS_MODE_12, duration_s=5.0 * SLOW_RAMP_S)
    dut.write(objects.TARGET_VELOCITY, 0, -at.velocity)
    turned = wait(dut, lambda: actual_velocity(dut) <= -0.8 * at.velocity, 5.0 * SLOW_RAMP_S)
    dut.check("backward", f"{-at.velocity} (606Ch)", str(actual_velocity(dut)), turned is not None)
    _halt(dut, at.velocity)
    switch_off(dut)


@action
def homing(dut: DeviceUnderTest) -> None:
    """Methods 37 and 35 move nothing: the present position becomes the home offset."""
    index = objects.HOMING_METHOD
    method = next((m for m in _PRESENT_POSITION if dut.try_to_write(index, 0, bytes((m,))) == b""), None)
    if method is None:
        raise NotApplicableError("6098h takes neither 37 nor 35")
    enable(dut, OperationMode.HOMING)
    command(dut, _ENABLED)
    command(dut, _ENABLED | _START)
    status_bit(dut, f"method {method}: homing attained", STATUS_MODE_12)
    status_bit(dut, f"method {method}: target reached", STATUS_TARGET_REACHED)
    status_bit(dut, f"method {method}: no homing error", STATUS_MODE_13, set_=False)
    offset = dut.signed(objects.HOME_OFFSET) if dut.eds.has(objects.HOME_OFFSET) else 0
    found = dut.signed(objects.POSITION_ACTUAL_VALUE)
    near = max(5, round(2.0 * pi / units(dut).position_rad) // 1000)
    dut.check("position", f"{offset}, the home offset 607Ch, to {near}", str(found), abs(found - offset) <= near)
    switch_off(dut)


# -- limits ----------------------------------------------------------------------------------------------------


@action
def software_limits(dut: DeviceUnderTest) -> None:
    """A set-point beyond 607Dh is refused, or the drive stays within."""
    limit = objects.SOFTWARE_POSITION_LIMIT
    at = speed(dut)
    write(dut, {(objects.PROFILE_VELOCITY, 0): at.velocity})
    turn_units = round(2.0 * pi / at.units.position_rad)
    begin = dut.signed(objects.POSITION_ACTUAL_VALUE)
    dut.write(limit, 1, begin - turn_units // 4)
    dut.write(limit, 2, begin + turn_units // 4)
    enable(dut, OperationMode.PROFILE_POSITION)
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


@action
def velocity_limits(dut: DeviceUnderTest) -> None:
    """Half the speed is the limit."""
    at = speed(dut)
    there = [i for i in (objects.MAX_PROFILE_VELOCITY, objects.MAX_MOTOR_SPEED) if dut.eds.can_write(i)]
    if not there:
        raise NotApplicableError("neither 607Fh nor 6080h can be written by the EDS file")
    for index in there:
        before = dut.value(index)
        limit = at.velocity // 2
        dut.write(index, 0, limit if index == objects.MAX_PROFILE_VELOCITY else 30)
        enable(dut, OperationMode.PROFILE_VELOCITY)
        answer = dut.try_to_write(objects.TARGET_VELOCITY, 0, dut.data_of(objects.TARGET_VELOCITY, 0, at.velocity))
        dut.wait(2.0 * SLOW_RAMP_S)
        found = abs(actual_velocity(dut))
        most = round(_TOLERATED * limit) + 1
        seen = f"{found} (606Ch)" if answer == b"" else taken_text(answer)
        dut.check(f"twice the limit {index:04X}h", f"{most} at most", seen, found <= most)
        switch_off(dut)
        dut.write(index, 0, before)


@action
def following_error(dut: DeviceUnderTest) -> None:
    """A window of one unit is left as soon as it turns: at a ramp that no loop follows within that."""
    at = speed(dut)
    write(dut, {(objects.PROFILE_VELOCITY, 0): at.velocity})
    steep = round(at.velocity / _STEEP_RAMP_S)
    write(dut, {(objects.PROFILE_ACCELERATION, 0): steep, (objects.FOLLOWING_ERROR_TIME_OUT, 0): 0})
    turn_units = round(2.0 * pi / at.units.position_rad)
    begin = dut.signed(objects.POSITION_ACTUAL_VALUE)
    enable(dut, OperationMode.PROFILE_POSITION)
    dut.write(objects.FOLLOWING_ERROR_WINDOW, 0, 1)
    dut.write(objects.TARGET_POSITION, 0, begin + turn_units)
    command(dut, _ENABLED)
    command(dut, _ENABLED | _START)
    expect_state(dut, "6065h = 1, a motion of a turn", State.FAULT)
    if dut.eds.has(objects.ERROR_CODE):
        dut.reads("error code 603Fh", objects.ERROR_CODE, 0, 0x8611)
    dut.write(objects.FOLLOWING_ERROR_WINDOW, 0, 0xFFFF_FFFF)
    switch_off(dut)
