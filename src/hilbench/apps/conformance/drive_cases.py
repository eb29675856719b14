"""Actions of cases of CiA 402: power drive system FSA, option codes, modes of operation and limits.

Every command in every state, and the statusword; how long each option code takes a turning motor to rest, and the state
then; what 6502h promises, with motions of a turn at most.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import pi
from typing import Final

from hilbench.apps.conformance.actions import Key
from hilbench.apps.conformance.dut import DeviceUnderTest, taken_text
from hilbench.apps.conformance.power import (
    QUICK_RAMP_S,
    SLOW_RAMP_S,
    STATE_S,
    actual_velocity,
    bring,
    choose,
    command,
    enable,
    expect_state,
    expect_stays,
    fail,
    find_connection,
    label,
    lose_connection,
    speed,
    state,
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
from hilbench.cia402.axis import SEVERAL
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.state_machine import (
    CONTROLWORD_FAULT_RESET,
    CONTROLWORD_HALT,
    DESTINATION,
    STATUS_MASK,
    STATUS_MODE_12,
    STATUS_MODE_13,
    STATUS_REMOTE,
    STATUS_TARGET_REACHED,
    STATUS_VOLTAGE_ENABLED,
    Command,
    State,
    commanded,
)
from hilbench.cia402.stopping import QUICK_STOP_OPTIONS

_HARMLESS: Final = (Command.DISABLE_VOLTAGE, Command.QUICK_STOP, Command.SHUTDOWN)
_CIA_402, _TYPE_OF_AXIS = 402, 0x67FF
#: Quick stop option codes by which a drive stays in QUICK STOP ACTIVE.
_STAYS: Final = tuple(code for code, (_, stays) in QUICK_STOP_OPTIONS.items() if stays)
_NAMES: Final = {each: each.name.replace("_", " ").lower() for each in Command}
_ENABLED: Final = Command.ENABLE_OPERATION.value
_HALT: Final = _ENABLED | CONTROLWORD_HALT
#: How far the time of a ramp may be off: inertia and the drive's own smoothing are the machine's.
_LONGEST, _SHORTEST = 1.8, 0.45
_ASKED_S: Final = 0.1  #: a value is read when its answer comes
_START: Final = 1 << 4  #: controlword: new set-point, or homing begins
_PRESENT_POSITION: Final = (37, 35)
_TOLERATED: Final = 1.1
_MOTION_S: Final = 10.0
_STEEP_RAMP_S: Final = 0.01  #: from rest to 60 rpm: shorter than a position loop of 40 1/s settles


#: Where a drive may choose: it goes further by itself, 605Ah decides, transition 16 is optional.
_MAY: Final = {
    (State.READY_TO_SWITCH_ON, Command.ENABLE_OPERATION): (State.OPERATION_ENABLED, State.SWITCHED_ON),
    (State.OPERATION_ENABLED, Command.QUICK_STOP): (State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED),
    (State.QUICK_STOP_ACTIVE, Command.ENABLE_OPERATION): (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE),
}


def every_command(dut: DeviceUnderTest, before: State) -> None:
    """Each from this state; without permission those that take no power."""
    for asked in Command:
        if asked not in _HARMLESS and not dut.motion:
            dut.notes.append(f"'{_NAMES[asked]}' was not sent: --allow-motion")
            continue
        bring(dut, before)
        _expect(dut, before, asked)
    switch_off(dut)


def _expect(dut: DeviceUnderTest, before: State, asked: Command) -> None:
    what = f"'{_NAMES[asked]}' ({asked.value:04X}h) in {before.label}"
    command(dut, asked.value)
    transition = commanded(before, asked.value, 0)
    wanted = _MAY.get((before, asked), () if transition is None else (DESTINATION[transition],))
    if not wanted:
        expect_stays(dut, what, before)
    else:
        expect_state(dut, what, *wanted, duration_s=0.5 if before in wanted else STATE_S)


def _quick_stop_active(dut: DeviceUnderTest) -> None:
    bring(dut, State.OPERATION_ENABLED)
    command(dut, Command.QUICK_STOP.value)
    dut.must(expect_state(dut, "quick stop", State.QUICK_STOP_ACTIVE))


def _needs_staying(dut: DeviceUnderTest) -> None:
    """605Ah so that the drive stays in QUICK STOP ACTIVE."""
    dut.needs_to_write([(objects.QUICK_STOP_OPTION_CODE, 0)])
    if not any(dut.offer(objects.QUICK_STOP_OPTION_CODE, code) == b"" for code in _STAYS):
        raise NotApplicableError("605Ah takes none of 5 to 8: the drive never stays in QUICK STOP ACTIVE")


def in_quick_stop_active(dut: DeviceUnderTest) -> None:
    """Left by transition 12, and by 16 where the drive has it."""
    _needs_staying(dut)
    for asked in Command:
        _quick_stop_active(dut)
        _expect(dut, State.QUICK_STOP_ACTIVE, asked)
        if asked is Command.ENABLE_OPERATION and state(dut) is State.QUICK_STOP_ACTIVE:
            dut.notes.append("the drive has no transition 16 (optional)")
    switch_off(dut)


def in_fault(dut: DeviceUnderTest) -> None:
    """Left by the rising edge of bit 7 alone."""
    bring(dut, State.OPERATION_ENABLED)
    fail(dut)
    for asked in Command:
        _expect(dut, State.FAULT, asked)
    command(dut, Command.DISABLE_VOLTAGE.value)
    command(dut, CONTROLWORD_FAULT_RESET)
    expect_state(dut, "rising edge of bit 7", State.SWITCH_ON_DISABLED)
    command(dut, Command.DISABLE_VOLTAGE.value)


def statusword_bits(dut: DeviceUnderTest) -> None:
    """The pattern of the state, remote (9), voltage (4) while enabled, and no quick stop (5 is 1)."""
    switch_off(dut)
    _bits(dut, State.SWITCH_ON_DISABLED)
    bring(dut, State.READY_TO_SWITCH_ON)
    _bits(dut, State.READY_TO_SWITCH_ON)
    if not dut.motion:
        dut.notes.append("SWITCHED ON, OPERATION ENABLED and QUICK STOP ACTIVE were not looked at: --allow-motion")
        switch_off(dut)
        return
    for wanted in (State.SWITCHED_ON, State.OPERATION_ENABLED):
        bring(dut, wanted)
        _bits(dut, wanted)
    try:
        _needs_staying(dut)
    except NotApplicableError as error:
        dut.notes.append(str(error))
    else:
        _quick_stop_active(dut)
        _bits(dut, State.QUICK_STOP_ACTIVE)
    switch_off(dut)


def _bits(dut: DeviceUnderTest, wanted: State) -> None:
    found = statusword(dut)
    mask, pattern = STATUS_MASK[wanted] | STATUS_REMOTE, wanted.value | STATUS_REMOTE
    if wanted in (State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE):
        mask, pattern = mask | STATUS_VOLTAGE_ENABLED, pattern | STATUS_VOLTAGE_ENABLED
    ok = found & mask == pattern
    seen = f"{found:04X}h ({label(state(dut))})"
    dut.check(f"statusword in {wanted.label}", f"{pattern:04X}h in the bits {mask:04X}h", seen, ok)


def several_axes(dut: DeviceUnderTest) -> None:
    """1000h states several axes, and its profile is that of the first; each axis may have a type of its own."""
    if len(dut.eds.axes) == 1:
        raise NotApplicableError("one axis: 6840h and 6841h are not in the EDS file")
    kind = dut.value(0x1000)
    ok = kind == SEVERAL << 16 | _CIA_402
    dut.check(
        "1000h", f"{SEVERAL:04X}{_CIA_402:04X}h: several logical devices, the first of CiA 402", f"{kind:08X}h", ok
    )
    if dut.eds.has(_TYPE_OF_AXIS):
        kind = dut.value(_TYPE_OF_AXIS)
        dut.check(
            dut.name(_TYPE_OF_AXIS, 0), f"{_CIA_402:04X}h in the lower half", f"{kind:08X}h", kind & 0xFFFF == _CIA_402
        )
    else:
        dut.notes.append(f"{dut.name(_TYPE_OF_AXIS, 0)} is not in the EDS file")


def _codes(dut: DeviceUnderTest, index: int, codes: range) -> Iterator[tuple[int, int]]:
    """Each code that the drive takes, the motor turning; and its speed. The drive is off after each."""
    dut.needs_to_write([(index, 0)])
    velocity, _ = speed(dut)
    taken = 0
    for code in codes:
        answer = dut.offer(index, code)
        if answer != b"":
            dut.notes.append(f"{index:04X}h = {code} is not taken ({taken_text(answer)})")
            continue
        taken += 1
        turn(dut, velocity)
        yield code, velocity
        switch_off(dut)
        time_to_rest(dut, velocity)
    if not taken:
        raise NotApplicableError(f"{index:04X}h takes no code of the standard")


def _ramp(dut: DeviceUnderTest, what: str, velocity: int, ramp_s: float | None) -> None:
    """Expect a ramp of this time; None: whatever brings it to rest."""
    taken_s = time_to_rest(dut, velocity)
    seen = "never" if taken_s is None else f"after {taken_s:.2f} s"
    ramps = objects.PROFILE_DECELERATION, objects.QUICK_STOP_DECELERATION
    if ramp_s is None or not all(map(dut.eds.can_write, ramps)):
        dut.check(f"{what}: at rest", "in the end", seen, taken_s is not None)
        return
    ok = taken_s is not None and _SHORTEST * ramp_s <= taken_s <= _LONGEST * ramp_s + _ASKED_S
    dut.check(f"{what}: at rest", f"after {0.9 * ramp_s:.2f} s", seen, ok)


_RAMPS: Final = {1: SLOW_RAMP_S, 2: QUICK_RAMP_S, 5: SLOW_RAMP_S, 6: QUICK_RAMP_S}


def stopping(
    dut: DeviceUnderTest, key: Key, asked: Command, codes: int, after: State, at_once_s: float = STATE_S
) -> None:
    """0: power off at once, within a time; others down a ramp first (1 and 5 by 6084h, 2 and 6 by 6085h), and those of
    a quick stop from 5 on stay in QUICK STOP ACTIVE."""
    for code, velocity in _codes(dut, key[0], range(codes)):
        what, end = f"{key[0]:04X}h = {code}", State.QUICK_STOP_ACTIVE if code in _STAYS else after
        command(dut, asked.value)
        if code:
            _ramp(dut, what, velocity, _RAMPS.get(code))
        expect_state(dut, what, end, duration_s=STATE_S if code else at_once_s)


def halt(dut: DeviceUnderTest) -> None:
    """1: 6084h, 2: 6085h, 3 and 4 as hard as it can; OPERATION ENABLED stays, and the motion goes on without halt."""
    for code, velocity in _codes(dut, objects.HALT_OPTION_CODE, range(1, 5)):
        what = f"605Dh = {code}"
        command(dut, _HALT)
        _ramp(dut, what, velocity, _RAMPS.get(code))
        expect_state(dut, what, State.OPERATION_ENABLED)
        command(dut, _ENABLED)
        went_on = wait(dut, lambda velocity=velocity: abs(actual_velocity(dut)) >= 0.8 * velocity, 5.0 * SLOW_RAMP_S)  # type: ignore[misc]
        dut.check(
            f"{what}: halt taken back", f"{velocity} again (606Ch)", str(actual_velocity(dut)), went_on is not None
        )


def fault_reaction(dut: DeviceUnderTest) -> None:
    """A fault while turning: 0 without a ramp, 1 by 6084h, 2 by 6085h; FAULT in the end."""
    for code, _ in _codes(dut, objects.FAULT_REACTION_OPTION_CODE, range(5)):
        lose_connection(dut)
        expect_state(dut, f"605Eh = {code}, a watched heartbeat stays away", State.FAULT)
        find_connection(dut)


def connection_lost(dut: DeviceUnderTest) -> None:
    """0 nothing, 1 fault, 2 disable voltage, 3 quick stop."""
    ends = {
        0: (State.OPERATION_ENABLED,),
        1: (State.FAULT,),
        2: (State.SWITCH_ON_DISABLED,),
        3: (State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED),
    }
    for code, _ in _codes(dut, objects.ABORT_CONNECTION_OPTION_CODE, range(4)):
        lose_connection(dut)
        expect_state(dut, f"6007h = {code}, a watched heartbeat stays away", *ends[code])
        if code == 3 and state(dut) is State.QUICK_STOP_ACTIVE:
            dut.notes.append("6007h = 3: stays in QUICK STOP ACTIVE, by 605Ah")
        find_connection(dut)


def each_mode(dut: DeviceUnderTest) -> None:
    """Without power."""
    for mode in supported(dut):
        choose(dut, mode)
        dut.reads(f"6061h after 6060h = {int(mode)}", objects.MODES_OF_OPERATION_DISPLAY, 0, int(mode))


def other_mode(dut: DeviceUnderTest) -> None:
    """Refused, or never shown."""
    there = supported(dut)
    before = dut.value(objects.MODES_OF_OPERATION_DISPLAY)
    absent = [mode for mode in OperationMode if mode and mode not in there]
    for mode in [int(mode) for mode in absent] or [99]:
        answer = dut.offer(objects.MODES_OF_OPERATION, mode)
        dut.wait(0.1)
        shown = dut.value(objects.MODES_OF_OPERATION_DISPLAY)
        ok = answer != b"" or shown != mode
        seen = f"taken, 6061h is {shown}" if answer == b"" else taken_text(answer)
        dut.check(f"{mode} to 6060h", f"refused, or 6061h stays {before}", seen, ok)


def status_bit(dut: DeviceUnderTest, what: str, bit: int, set_: bool = True, duration_s: float = 1.0) -> bool:
    """Expect a bit of the statusword within a time."""
    came = wait(dut, lambda: bool(statusword(dut) & bit) is set_, duration_s) is not None
    number = bit.bit_length() - 1
    return dut.check(what, f"statusword bit {number} {'set' if set_ else 'clear'}", f"{statusword(dut):04X}h", came)


def profile_position(dut: DeviceUnderTest) -> None:
    """A quarter of a turn, and back; then halted."""
    velocity, turn_units = _motion(dut)
    enable(dut, OperationMode.PROFILE_POSITION)
    begin = dut.signed(objects.POSITION_ACTUAL_VALUE)
    for target in (begin + turn_units // 4, begin):
        _set_point(dut, target)
        status_bit(dut, f"set-point {target}: target reached", STATUS_TARGET_REACHED, duration_s=_MOTION_S)
        found = dut.signed(objects.POSITION_ACTUAL_VALUE)
        near = abs(found - target) <= max(2, turn_units // 100)
        dut.check(f"position after set-point {target}", f"{target} to 1 % of a turn", str(found), near)
    _set_point(dut, begin + turn_units)
    wait(dut, lambda: abs(actual_velocity(dut)) > 0.5 * velocity, SLOW_RAMP_S)
    _halt(dut, velocity)
    status_bit(dut, "halt: target reached at standstill", STATUS_TARGET_REACHED)
    switch_off(dut)


def _motion(dut: DeviceUnderTest) -> tuple[int, int]:
    """Speed of a motion to a position, which is set, and position units of a turn."""
    velocity, known = speed(dut)
    write(dut, {(objects.PROFILE_VELOCITY, 0): velocity})
    return velocity, round(2.0 * pi / known.position_rad)


def _begin(dut: DeviceUnderTest) -> None:
    """Rising edge of bit 4: a new set-point, or homing begins."""
    command(dut, _ENABLED)
    command(dut, _ENABLED | _START)


def _halt(dut: DeviceUnderTest, velocity: int) -> None:
    command(dut, _HALT)
    stood = time_to_rest(dut, velocity) is not None
    dut.check("halt", "at rest", "at rest" if stood else "turns", stood)


def _set_point(dut: DeviceUnderTest, target: int) -> None:
    """The handshake: bit 4, acknowledged by bit 12, and both taken back."""
    dut.write(objects.TARGET_POSITION, 0, target)
    _begin(dut)
    dut.must(status_bit(dut, f"new set-point {target}: acknowledged", STATUS_MODE_12))
    command(dut, _ENABLED)
    status_bit(dut, "bit 4 taken back: acknowledgement too", STATUS_MODE_12, set_=False, duration_s=_MOTION_S)


def profile_velocity(dut: DeviceUnderTest) -> None:
    """Examine profile velocity: bit 10 at speed, bit 12 at rest."""
    velocity, _ = speed(dut)
    turn(dut, velocity)
    status_bit(dut, "at speed: target reached", STATUS_TARGET_REACHED, duration_s=2.0)
    status_bit(dut, "at speed: not at rest", STATUS_MODE_12, set_=False)
    dut.write(objects.TARGET_VELOCITY, 0, 0)
    status_bit(dut, "at rest: speed 0", STATUS_MODE_12, duration_s=5.0 * SLOW_RAMP_S)
    dut.write(objects.TARGET_VELOCITY, 0, -velocity)
    turned = wait(dut, lambda: actual_velocity(dut) <= -0.8 * velocity, 5.0 * SLOW_RAMP_S)
    dut.check("backward", f"{-velocity} (606Ch)", str(actual_velocity(dut)), turned is not None)
    _halt(dut, velocity)
    switch_off(dut)


def homing(dut: DeviceUnderTest) -> None:
    """Methods 37 and 35 move nothing: the present position becomes the home offset."""
    index = objects.HOMING_METHOD
    method = next((m for m in _PRESENT_POSITION if dut.offer(index, m) == b""), None)
    if method is None:
        raise NotApplicableError("6098h takes neither 37 nor 35")
    enable(dut, OperationMode.HOMING)
    _begin(dut)
    status_bit(dut, f"method {method}: homing attained", STATUS_MODE_12)
    status_bit(dut, f"method {method}: target reached", STATUS_TARGET_REACHED)
    status_bit(dut, f"method {method}: no homing error", STATUS_MODE_13, set_=False)
    offset = dut.signed(objects.HOME_OFFSET) if dut.eds.has(objects.HOME_OFFSET) else 0
    found = dut.signed(objects.POSITION_ACTUAL_VALUE)
    near = max(5, round(2.0 * pi / units(dut).position_rad) // 1000)
    dut.check("position", f"{offset}, the home offset 607Ch, to {near}", str(found), abs(found - offset) <= near)
    switch_off(dut)


# -- limits ----------------------------------------------------------------------------------------------------


def software_limits(dut: DeviceUnderTest) -> None:
    """A set-point beyond 607Dh is refused, or the drive stays within."""
    limit = objects.SOFTWARE_POSITION_LIMIT
    _, turn_units = _motion(dut)
    begin = dut.signed(objects.POSITION_ACTUAL_VALUE)
    dut.write(limit, 1, begin - turn_units // 4)
    dut.write(limit, 2, begin + turn_units // 4)
    enable(dut, OperationMode.PROFILE_POSITION)
    answer = dut.offer(objects.TARGET_POSITION, begin + turn_units // 2)
    if answer != b"":
        dut.check("set-point beyond 607Dh:2", "refused, or not reached", taken_text(answer), answer is not None)
    else:
        _begin(dut)
        dut.wait(2.0)
        found = dut.signed(objects.POSITION_ACTUAL_VALUE)
        furthest = begin + turn_units // 4 + turn_units // 100 + 2
        dut.check("half a turn, limit at a quarter", f"position up to {furthest}", str(found), found <= furthest)
    switch_off(dut)


def velocity_limits(dut: DeviceUnderTest) -> None:
    """Half the speed is the limit."""
    velocity, _ = speed(dut)
    there = [i for i in (objects.MAX_PROFILE_VELOCITY, objects.MAX_MOTOR_SPEED) if dut.eds.can_write(i)]
    if not there:
        raise NotApplicableError("neither 607Fh nor 6080h can be written by the EDS file")
    for index in there:
        before = dut.value(index)
        limit = velocity // 2
        dut.write(index, 0, limit if index == objects.MAX_PROFILE_VELOCITY else 30)
        enable(dut, OperationMode.PROFILE_VELOCITY)
        answer = dut.offer(objects.TARGET_VELOCITY, velocity)
        dut.wait(2.0 * SLOW_RAMP_S)
        found = abs(actual_velocity(dut))
        most = round(_TOLERATED * limit) + 1
        seen = f"{found} (606Ch)" if answer == b"" else taken_text(answer)
        dut.check(f"twice the limit {index:04X}h", f"{most} at most", seen, found <= most)
        switch_off(dut)
        dut.write(index, 0, before)


def following_error(dut: DeviceUnderTest) -> None:
    """A window of one unit is left as soon as it turns: at a ramp that no loop follows within that."""
    velocity, turn_units = _motion(dut)
    steep = round(velocity / _STEEP_RAMP_S)
    write(dut, {(objects.PROFILE_ACCELERATION, 0): steep, (objects.FOLLOWING_ERROR_TIME_OUT, 0): 0})
    begin = dut.signed(objects.POSITION_ACTUAL_VALUE)
    enable(dut, OperationMode.PROFILE_POSITION)
    dut.write(objects.FOLLOWING_ERROR_WINDOW, 0, 1)
    dut.write(objects.TARGET_POSITION, 0, begin + turn_units)
    _begin(dut)
    expect_state(dut, "6065h = 1, a motion of a turn", State.FAULT)
    if dut.eds.has(objects.ERROR_CODE):
        dut.reads("error code 603Fh", objects.ERROR_CODE, 0, 0x8611)
    dut.write(objects.FOLLOWING_ERROR_WINDOW, 0, 0xFFFF_FFFF)
    switch_off(dut)
