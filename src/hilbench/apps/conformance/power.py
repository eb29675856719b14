"""A drive under test: into a power state, turning, and at rest again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from hilbench.apps.conformance.dut import DeviceUnderTest
from hilbench.apps.conformance.record import NotApplicableError
from hilbench.canopen.identifiers import HEARTBEAT
from hilbench.canopen.sdo_client import Refusal
from hilbench.cia402 import objects
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.state_machine import (
    CONTROLWORD_FAULT_RESET,
    POWERED,
    STATUS_TARGET_REACHED,
    Command,
    State,
    controlword_towards_enabled,
    decode_statusword,
)
from hilbench.cia402.units import RPM, DriveUnits
from hilbench.errors import UnusableInputError

_STEP_S: Final = 0.01
STATE_S: Final = 3.0  #: for a transition
_SPEED_RPM: Final = 60.0
#: The slow ramp (6083h, 6084h) takes so long from speed to rest, the quick stop's (6085h) a quarter.
SLOW_RAMP_S, QUICK_RAMP_S = 0.8, 0.2
_HEARTBEAT_MS: Final = 100
#: Modes in which a drive that is enabled stays where it is, the most harmless first, and their target.
_RESTING: Final = (
    (OperationMode.PROFILE_VELOCITY, objects.TARGET_VELOCITY),
    (OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY, objects.TARGET_VELOCITY),
    (OperationMode.PROFILE_POSITION, None),
    (OperationMode.VELOCITY, objects.VL_TARGET_VELOCITY),
    (OperationMode.TORQUE, objects.TARGET_TORQUE),
    (OperationMode.CYCLIC_SYNCHRONOUS_TORQUE, objects.TARGET_TORQUE),
)


def statusword(dut: DeviceUnderTest) -> int:
    """6041h."""
    return dut.value(objects.STATUSWORD)


def state(dut: DeviceUnderTest) -> State | None:
    """The power state that it shows."""
    return decode_statusword(statusword(dut))


def label(found: State | None) -> str:
    """Name of the state."""
    return "no state of CiA 402" if found is None else found.label


def command(dut: DeviceUnderTest, controlword: int) -> None:
    """Write 6040h."""
    dut.write(objects.CONTROLWORD, 0, controlword)


def wait(dut: DeviceUnderTest, condition: Callable[[], bool], duration_s: float = STATE_S) -> float | None:
    """Wait until a condition holds: how long that took (s); None: it never did."""
    begun_s = dut.wire.now_s()
    while not condition():
        if dut.wire.now_s() - begun_s >= duration_s:
            return None
        dut.wait(_STEP_S)
    return dut.wire.now_s() - begun_s


def expect_state(dut: DeviceUnderTest, what: str, wanted: State, *others: State, duration_s: float = STATE_S) -> bool:
    """Expect one of some states within a time."""
    states = (wanted, *others)
    wait(dut, lambda: state(dut) in states, duration_s)
    found = state(dut)
    return dut.check(what, " or ".join(each.label for each in states), label(found), found in states)


def expect_stays(dut: DeviceUnderTest, what: str, wanted: State) -> bool:
    """Expect that nothing changes in 0.1 s."""
    wait(dut, lambda: state(dut) is not wanted, 0.1)
    found = state(dut)
    return dut.check(what, f"stays in {wanted.label}", label(found), found is wanted)


def switch_off(dut: DeviceUnderTest) -> None:
    """Bring the drive to SWITCH ON DISABLED, by a fault reset if need be."""
    command(dut, Command.DISABLE_VOLTAGE.value)
    if state(dut) in (State.FAULT, State.FAULT_REACTION_ACTIVE):
        wait(dut, lambda: state(dut) is State.FAULT)
        command(dut, CONTROLWORD_FAULT_RESET)
        command(dut, Command.DISABLE_VOLTAGE.value)
    dut.must(
        wait(dut, lambda: state(dut) is State.SWITCH_ON_DISABLED) is not None or _hangs(dut, State.SWITCH_ON_DISABLED)
    )


def bring(dut: DeviceUnderTest, wanted: State) -> None:
    """Bring the drive from SWITCH ON DISABLED to READY TO SWITCH ON, SWITCHED ON or OPERATION ENABLED."""
    switch_off(dut)
    words = {State.READY_TO_SWITCH_ON: 1, State.SWITCHED_ON: 2, State.OPERATION_ENABLED: 3}
    if wanted is State.OPERATION_ENABLED:
        rest(dut)
    for _ in range(words.get(wanted, 0)):
        before = state(dut)
        if before is not None:
            command(dut, controlword_towards_enabled(before))
        if wait(dut, lambda before=before: state(dut) is not before) is None:  # type: ignore[misc]
            break
    if state(dut) is not wanted:
        dut.must(_hangs(dut, wanted))


def _hangs(dut: DeviceUnderTest, wanted: State) -> bool:
    return dut.check(f"on the way to {wanted.label}", wanted.label, label(state(dut)), False)


def supported(dut: DeviceUnderTest) -> list[OperationMode]:
    """Modes by 6502h; without it those that are taken, and shown in 6061h."""
    if not dut.eds.has(objects.SUPPORTED_DRIVE_MODES):
        return [mode for mode in OperationMode if mode and _takes(dut, mode)]
    bits = dut.value(objects.SUPPORTED_DRIVE_MODES)
    return [mode for mode in OperationMode if mode and bits & mode.supported_bit]


def _takes(dut: DeviceUnderTest, mode: OperationMode) -> bool:
    if dut.offer(objects.MODES_OF_OPERATION, mode) != b"":
        return False
    return wait(dut, lambda: dut.value(objects.MODES_OF_OPERATION_DISPLAY) == mode, 0.1) is not None


def needs_mode(dut: DeviceUnderTest, mode: OperationMode) -> None:
    """Choose it. Raises NotApplicableError when 6502h lacks it."""
    name = mode.name.replace("_", " ").lower()
    if mode not in supported(dut):
        raise NotApplicableError(f"no {name} mode (6502h)")
    choose(dut, mode)


def choose(dut: DeviceUnderTest, mode: OperationMode) -> None:
    """Write 6060h and see it in 6061h."""
    dut.write(objects.MODES_OF_OPERATION, 0, int(mode))
    if dut.eds.has(objects.MODES_OF_OPERATION_DISPLAY):
        wait(dut, lambda: dut.value(objects.MODES_OF_OPERATION_DISPLAY) == mode, 1.0)


def enable(dut: DeviceUnderTest, mode: OperationMode) -> None:
    """OPERATION ENABLED in a mode."""
    bring(dut, State.OPERATION_ENABLED)
    choose(dut, mode)


def rest(dut: DeviceUnderTest) -> None:
    """A mode in which an enabled drive stays where it is. Raises NotApplicableError when there is none."""
    there = supported(dut)
    for mode, target in _RESTING:
        if mode in there and (target is None or dut.eds.has(target)):
            choose(dut, mode)
            if target is not None:
                dut.write(target, 0, 0)
            return
    raise NotApplicableError("no mode (6502h) in which an enabled drive stands still by itself")


def shown_state(dut: DeviceUnderTest) -> State | None:
    """Power state of the drive; None: it shows none."""
    word = dut.number(objects.STATUSWORD)
    return None if word is None else decode_statusword(word)


def at_rest(dut: DeviceUnderTest) -> None:
    """A drive without power, whatever a case has left it in: a quick stop first, if it has some."""
    if not dut.eds.is_drive:
        return
    if shown_state(dut) in POWERED:
        _try_command(dut, Command.QUICK_STOP)
        wait(dut, lambda: _is_over(dut.number(objects.STATUSWORD) or 0))
    _try_command(dut, Command.DISABLE_VOLTAGE)


def _is_over(word: int) -> bool:
    """True by the statusword after a quick stop: target reached, or without power."""
    return decode_statusword(word) not in POWERED or bool(word & STATUS_TARGET_REACHED)


def _try_command(dut: DeviceUnderTest, word: Command) -> None:
    answer = dut.offer(objects.CONTROLWORD, word.value)
    if isinstance(answer, Refusal):
        dut.notes.append(f"6040h = {word.value} was refused, {answer}")


# -- turning ---------------------------------------------------------------------------------------------------


def units(dut: DeviceUnderTest) -> DriveUnits:
    """Units in the drive's objects. Raises NotApplicableError when they are missing."""

    def read(index: int, sub: int) -> float | None:
        return float(dut.signed(index, sub)) if dut.eds.has(index, sub) else None

    try:
        return DriveUnits.from_objects(read, {"rated_torque_Nm": 1.0}, "units")  # no case counts in N·m
    except UnusableInputError as error:
        raise NotApplicableError(f"the drive does not define its units: {error.problem}") from error


def speed(dut: DeviceUnderTest) -> tuple[int, DriveUnits]:
    """60 rpm of the motor in its own units, or what 6080h and 607Fh allow of it, and those units; ramps are set to go
    with it."""
    known = units(dut)
    limits = [_SPEED_RPM]
    if dut.eds.has(objects.MAX_MOTOR_SPEED):
        limits.append(dut.value(objects.MAX_MOTOR_SPEED) or _SPEED_RPM)
    velocity = round(min(limits) * RPM / known.velocity_rad_s)
    if dut.eds.has(objects.MAX_PROFILE_VELOCITY):
        velocity = min(velocity, dut.value(objects.MAX_PROFILE_VELOCITY) or velocity)
    if velocity < 10:
        raise NotApplicableError(f"60 rpm are {velocity} velocity units: too few to see a ramp in")
    ramps = {
        objects.PROFILE_ACCELERATION: SLOW_RAMP_S,
        objects.PROFILE_DECELERATION: SLOW_RAMP_S,
        objects.QUICK_STOP_DECELERATION: QUICK_RAMP_S,
    }
    for index, duration_s in ramps.items():
        if dut.eds.can_write(index):
            dut.write(index, 0, max(1, round(velocity / duration_s)))
    return velocity, known


def turn(dut: DeviceUnderTest, velocity: int) -> None:
    """Enabled in profile velocity mode, and at speed."""
    needs_mode(dut, OperationMode.PROFILE_VELOCITY)
    enable(dut, OperationMode.PROFILE_VELOCITY)
    dut.write(objects.TARGET_VELOCITY, 0, velocity)
    if wait(dut, lambda: abs(actual_velocity(dut)) >= 0.8 * abs(velocity), 5.0 * SLOW_RAMP_S) is None:
        dut.must(dut.check("at speed", f"{velocity} (606Ch)", str(actual_velocity(dut)), False))


def actual_velocity(dut: DeviceUnderTest) -> int:
    """606Ch."""
    return dut.signed(objects.VELOCITY_ACTUAL_VALUE)


def time_to_rest(dut: DeviceUnderTest, velocity: int) -> float | None:
    """Seconds to a tenth of the speed; None: it never comes to rest."""
    return wait(dut, lambda: abs(actual_velocity(dut)) <= 0.1 * abs(velocity), 5.0 * SLOW_RAMP_S)


# -- faults ----------------------------------------------------------------------------------------------------


def lose_connection(dut: DeviceUnderTest) -> None:
    """Stop a heartbeat that the drive consumes (1016h). Call `find_connection` when it is over."""
    node = dut.strangers(0.1)[0]
    dut.write(0x1016, 1, node << 16 | _HEARTBEAT_MS)
    dut.send(HEARTBEAT + node, b"\x05")
    dut.wait(3e-3 * _HEARTBEAT_MS)


def find_connection(dut: DeviceUnderTest) -> None:
    """Nobody is watched any more."""
    dut.write(0x1016, 1, 0)


def fail(dut: DeviceUnderTest) -> None:
    """Bring the drive from OPERATION ENABLED to FAULT: 6007h = 1 and a lost heartbeat."""
    dut.write(objects.ABORT_CONNECTION_OPTION_CODE, 0, 1)
    lose_connection(dut)
    dut.must(expect_state(dut, "6007h = 1, a watched heartbeat stays away", State.FAULT))
    find_connection(dut)
