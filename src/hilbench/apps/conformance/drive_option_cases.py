"""Actions of cases of CiA 402 about option codes: how long each takes a turning motor to rest, and the state then."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from hilbench.apps.conformance.actions import Key, action
from hilbench.apps.conformance.dut import DeviceUnderTest, taken_text
from hilbench.apps.conformance.power import (
    QUICK_RAMP_S,
    SLOW_RAMP_S,
    actual_velocity,
    command,
    expect_state,
    find_connection,
    lose_connection,
    speed,
    state,
    switch_off,
    time_to_rest,
    turn,
    wait,
)
from hilbench.apps.conformance.record import NotApplicableError
from hilbench.cia402 import objects
from hilbench.cia402.state_machine import CONTROLWORD_HALT, Command, State

_HALT: Final = Command.ENABLE_OPERATION.value | CONTROLWORD_HALT
#: How far the time of a ramp may be off: inertia and the drive's own smoothing are the machine's.
_LONGEST, _SHORTEST = 1.8, 0.45
_ASKED_S: Final = 0.1  #: a value is read when its answer comes


def _codes(dut: DeviceUnderTest, index: int, codes: range) -> Iterator[tuple[int, int]]:
    """Each code that the drive takes, the motor turning; and its speed. The drive is off after each."""
    dut.needs_to_write((index, 0))
    at = speed(dut)
    taken = 0
    for code in codes:
        answer = dut.try_to_write(index, 0, dut.data_of(index, 0, code))
        if answer != b"":
            dut.notes.append(f"{index:04X}h = {code} is not taken ({taken_text(answer)})")
            continue
        taken += 1
        turn(dut, at.velocity)
        yield code, at.velocity
        switch_off(dut)
        time_to_rest(dut, at.velocity)
    if not taken:
        raise NotApplicableError(f"{index:04X}h takes no code of the standard")


def _ramp(dut: DeviceUnderTest, what: str, velocity: int, ramp_s: float | None) -> None:
    """Expect a ramp of this time; None: whatever brings it to rest."""
    taken_s = time_to_rest(dut, velocity)
    seen = "never" if taken_s is None else f"after {taken_s:.2f} s"
    if ramp_s is None or not _has_ramps(dut):
        dut.check(f"{what}: at rest", "in the end", seen, taken_s is not None)
        return
    ok = taken_s is not None and _SHORTEST * ramp_s <= taken_s <= _LONGEST * ramp_s + _ASKED_S
    dut.check(f"{what}: at rest", f"after {0.9 * ramp_s:.2f} s", seen, ok)


def _has_ramps(dut: DeviceUnderTest) -> bool:
    return all(dut.eds.can_write(i) for i in (objects.PROFILE_DECELERATION, objects.QUICK_STOP_DECELERATION))


_RAMPS: Final = {1: SLOW_RAMP_S, 2: QUICK_RAMP_S, 5: SLOW_RAMP_S, 6: QUICK_RAMP_S}


@action
def quick_stop(dut: DeviceUnderTest) -> None:
    """0 to 4 end in SWITCH ON DISABLED, 5 to 8 stay in QUICK STOP ACTIVE; 1 and 5 by 6084h, 2 and 6 by 6085h."""
    for code, velocity in _codes(dut, objects.QUICK_STOP_OPTION_CODE, range(9)):
        command(dut, Command.QUICK_STOP.value)
        if code:
            _ramp(dut, f"605Ah = {code}", velocity, _RAMPS.get(code))
        expect_state(dut, f"605Ah = {code}", State.QUICK_STOP_ACTIVE if code >= 5 else State.SWITCH_ON_DISABLED)


@action
def disabling(dut: DeviceUnderTest, key: Key, asked: Command, after: State) -> None:
    """0: power off at once; 1: down the ramp first."""
    for code, velocity in _codes(dut, key[0], range(2)):
        command(dut, asked.value)
        what = f"{key[0]:04X}h = {code}"
        if code:
            _ramp(dut, what, velocity, SLOW_RAMP_S)
            expect_state(dut, what, after)
        else:
            expect_state(dut, what, after, duration_s=0.3)


@action
def halt(dut: DeviceUnderTest) -> None:
    """1: 6084h, 2: 6085h, 3 and 4 as hard as it can; OPERATION ENABLED stays, and the motion goes on without halt."""
    for code, velocity in _codes(dut, objects.HALT_OPTION_CODE, range(1, 5)):
        what = f"605Dh = {code}"
        command(dut, _HALT)
        _ramp(dut, what, velocity, _RAMPS.get(code))
        expect_state(dut, what, State.OPERATION_ENABLED)
        command(dut, Command.ENABLE_OPERATION.value)
        went_on = wait(dut, lambda velocity=velocity: abs(actual_velocity(dut)) >= 0.8 * velocity, 5.0 * SLOW_RAMP_S)  # type: ignore[misc]
        dut.check(
            f"{what}: halt taken back", f"{velocity} again (606Ch)", str(actual_velocity(dut)), went_on is not None
        )


@action
def fault_reaction(dut: DeviceUnderTest) -> None:
    """A fault while turning: 0 without a ramp, 1 by 6084h, 2 by 6085h; FAULT in the end."""
    for code, _ in _codes(dut, objects.FAULT_REACTION_OPTION_CODE, range(5)):
        lose_connection(dut)
        expect_state(dut, f"605Eh = {code}, a watched heartbeat stays away", State.FAULT)
        find_connection(dut)


@action
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
