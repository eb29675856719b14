"""Actions of cases about the power drive system FSA of CiA 402: every command in every state, and the statusword."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from hilbench.apps.conformance.actions import action
from hilbench.apps.conformance.dut import DeviceUnderTest
from hilbench.apps.conformance.power import (
    bring,
    command,
    expect_state,
    expect_stays,
    fail,
    label,
    state,
    statusword,
    switch_off,
)
from hilbench.apps.conformance.record import NotApplicableError
from hilbench.cia402 import objects
from hilbench.cia402.axis import SEVERAL
from hilbench.cia402.state_machine import (
    CONTROLWORD_FAULT_RESET,
    DESTINATION,
    STATUS_MASK,
    STATUS_REMOTE,
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


def _destinations(before: State, asked: Command) -> Sequence[State]:
    """Destination states of a command; "enable operation" in READY TO SWITCH ON may lead further by itself."""
    if (before, asked) == (State.READY_TO_SWITCH_ON, Command.ENABLE_OPERATION):
        return State.OPERATION_ENABLED, State.SWITCHED_ON
    transition = commanded(before, asked.value, 0)
    return (before,) if transition is None else (DESTINATION[transition],)


@action
def every_command(dut: DeviceUnderTest, before: State) -> None:
    """Each from this state; without permission those that take no power."""
    for asked in Command:
        if asked not in _HARMLESS and not dut.allowed.motion:
            dut.notes.append(f"'{_NAMES[asked]}' was not sent: --allow-motion")
            continue
        bring(dut, before)
        _expect(dut, before, asked, _destinations(before, asked))
    switch_off(dut)


def _expect(dut: DeviceUnderTest, before: State, asked: Command, wanted: Sequence[State]) -> None:
    what = f"'{_NAMES[asked]}' ({asked.value:04X}h) in {before.label}"
    command(dut, asked.value)
    if before is State.OPERATION_ENABLED and asked is Command.QUICK_STOP:
        wanted = (State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED)  # by 605Ah
    if tuple(wanted) == (before,):
        expect_stays(dut, what, before)
    else:
        expect_state(dut, what, *wanted)


def _quick_stop_active(dut: DeviceUnderTest) -> None:
    bring(dut, State.OPERATION_ENABLED)
    command(dut, Command.QUICK_STOP.value)
    dut.must(expect_state(dut, "quick stop", State.QUICK_STOP_ACTIVE))


def _needs_staying(dut: DeviceUnderTest) -> None:
    """605Ah so that the drive stays in QUICK STOP ACTIVE."""
    dut.needs_to_write((objects.QUICK_STOP_OPTION_CODE, 0))
    for code in _STAYS:
        if (
            dut.try_to_write(objects.QUICK_STOP_OPTION_CODE, 0, dut.data_of(objects.QUICK_STOP_OPTION_CODE, 0, code))
            == b""
        ):
            return
    raise NotApplicableError("605Ah takes none of 5 to 8: the drive never stays in QUICK STOP ACTIVE")


@action
def in_quick_stop_active(dut: DeviceUnderTest) -> None:
    """Left by transition 12, and by 16 where the drive has it."""
    _needs_staying(dut)
    for asked in Command:
        _quick_stop_active(dut)
        what = f"'{_NAMES[asked]}' ({asked.value:04X}h) in QUICK STOP ACTIVE"
        command(dut, asked.value)
        if asked is Command.DISABLE_VOLTAGE:
            expect_state(dut, what, State.SWITCH_ON_DISABLED)
        elif asked is Command.ENABLE_OPERATION:
            expect_state(dut, what, State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, duration_s=0.5)
            if state(dut) is State.QUICK_STOP_ACTIVE:
                dut.notes.append("the drive has no transition 16 (optional)")
        else:
            expect_stays(dut, what, State.QUICK_STOP_ACTIVE)
    switch_off(dut)


@action
def in_fault(dut: DeviceUnderTest) -> None:
    """Left by the rising edge of bit 7 alone."""
    bring(dut, State.OPERATION_ENABLED)
    fail(dut)
    for asked in Command:
        command(dut, asked.value)
        expect_stays(dut, f"'{_NAMES[asked]}' ({asked.value:04X}h) in FAULT", State.FAULT)
    command(dut, Command.DISABLE_VOLTAGE.value)
    command(dut, CONTROLWORD_FAULT_RESET)
    expect_state(dut, "rising edge of bit 7", State.SWITCH_ON_DISABLED)
    command(dut, Command.DISABLE_VOLTAGE.value)


@action
def statusword_bits(dut: DeviceUnderTest) -> None:
    """The pattern of the state, remote (9), voltage (4) while enabled, and no quick stop (5 is 1)."""
    switch_off(dut)
    _bits(dut, State.SWITCH_ON_DISABLED)
    bring(dut, State.READY_TO_SWITCH_ON)
    _bits(dut, State.READY_TO_SWITCH_ON)
    if not dut.allowed.motion:
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


@action
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
