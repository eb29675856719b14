"""What masters of others expect of a drive: ros2_canopen's Motor402 and the state machine of canopen's BaseNode402.

The steps are those that ros2_canopen (canopen_402_driver, 6ada196) takes, read from its source; every cycle writes a
controlword and reads statusword and 6061h, as it does by PDO or SDO.
"""

from __future__ import annotations

from collections.abc import Iterable

import pytest
from canopen.profiles.p402 import State402
from tests.cia402.every_mode import INCREMENTS, EveryMode
from tests.cia402.stand_in import DriveUnderTest

from hilbench.cia402.switches import Switches, Zone

HALT, IMMEDIATE, NEW_POINT, START_HOMING = 0x100, 0x20, 0x10, 0x10
REACHED, SPECIFIC_0, SPECIFIC_1 = 0x0400, 0x1000, 0x2000
ENABLED, NO_MODE, POSITION, VELOCITY, HOMING = 0x27, 0, 1, 3, 6


def commanded(drive: EveryMode, word: int, cycles: int = 5) -> int:
    """The state bits after a controlword."""
    return drive.controlword(word, cycles) & 0x6F


@pytest.fixture
def initialised() -> EveryMode:
    """A drive as `handleInit` leaves it before homing: enabled with the halt bit set, which is there without a mode."""
    drive = EveryMode()
    assert commanded(drive, HALT) & 0x4F == 0x40
    for word, state in ((0x06, 0x21), (0x07, 0x23), (0x0F, ENABLED)):
        assert commanded(drive, HALT | word) == state
    return drive


def test_it_is_enabled_while_the_halt_bit_is_set(initialised: EveryMode) -> None:
    assert abs(initialised.turns) < 1e-6


def test_a_fault_is_reset_by_the_edge_of_bit_7_with_the_halt_bit_set(initialised: EveryMode) -> None:
    drive = initialised
    drive.drive.fault(0x8611)
    drive.seconds(0.5)
    assert drive.read(0x6041) & 0x4F == 0x08
    assert commanded(drive, HALT | 0x0F) & 0x4F == 0x08
    assert commanded(drive, HALT | 0x8F) & 0x4F == 0x40
    for word, state in ((0x06, 0x21), (0x07, 0x23), (0x0F, ENABLED)):
        assert commanded(drive, HALT | word) == state


def test_modes_are_changed_while_it_is_enabled_and_0_is_a_mode(initialised: EveryMode) -> None:
    drive = initialised
    for mode in (VELOCITY, POSITION, NO_MODE, HOMING, NO_MODE):
        drive.write(0x6060, mode)
        drive.controlword(HALT | 0x0F, 5)
        assert drive.read(0x6061) == mode
        assert drive.read(0x6041) & 0x6F == ENABLED


def test_homing_goes_through_the_states_of_its_statusword_that_are_waited_for(initialised: EveryMode) -> None:
    """Before the start: reached or error; then not `reached alone`; then attained, then reached; never error."""
    drive = EveryMode(Switches(home=Zone(3.0, 4.0)))
    drive.write(0x6098, 24)
    for word in (0x06, 0x07, 0x0F):
        commanded(drive, HALT | word)
    drive.write(0x6060, HOMING)
    seen = list(statuses(drive, [HALT | 0x0F] * 5))
    assert seen[-1] == REACHED
    seen = list(statuses(drive, [0x0F | START_HOMING] * 4000))
    assert seen[-1] == REACHED | SPECIFIC_0
    assert seen[0] != REACHED
    assert not any(word & SPECIFIC_1 for word in seen)
    assert list(statuses(drive, [0x0F | HALT] * 5))[-1] & SPECIFIC_1 == 0


def statuses(drive: EveryMode, words: Iterable[int]) -> Iterable[int]:
    """Target reached and both bits of the mode, a cycle each."""
    for word in words:
        yield drive.controlword(word) & (REACHED | SPECIFIC_0 | SPECIFIC_1)


def test_profile_position_takes_each_new_target_at_once_by_its_handshake(initialised: EveryMode) -> None:
    """Bit 5 always set; bit 4 set with a target while bit 12 is clear, and cleared once it is set."""
    drive = initialised
    drive.write(0x6060, POSITION)
    drive.controlword(HALT | 0x0F, 3)
    for turns in (1.0, 3.0, -1.0):
        assert not drive.controlword(0x0F | IMMEDIATE, 3) & SPECIFIC_0
        drive.write(0x607A, round(turns * INCREMENTS))
        assert drive.controlword(0x0F | IMMEDIATE | NEW_POINT, 2) & SPECIFIC_0
        assert not drive.controlword(0x0F | IMMEDIATE, 2) & (SPECIFIC_0 | REACHED)
        drive.seconds(0.05)
    assert drive.seconds(3.0) & (REACHED | SPECIFIC_1) == REACHED
    assert drive.turns == pytest.approx(-1.0, abs=0.01)


def test_shutdown_takes_the_mode_away_and_the_voltage(initialised: EveryMode) -> None:
    drive = initialised
    drive.write(0x6060, NO_MODE)
    assert commanded(drive, HALT | 0x0F) == ENABLED
    assert commanded(drive, HALT | 0x0D & ~0x02) in (0x07, 0x40, 0x60)  # quick stop is a hop that it may take
    assert commanded(drive, HALT) & 0x4F == 0x40


def test_each_transition_of_canopens_table_leads_where_the_table_says() -> None:
    """The controlwords of `State402.TRANSITIONTABLE`, in every state of a drive that can be brought there."""
    ways = {
        "SWITCH ON DISABLED": [],
        "READY TO SWITCH ON": [0x06],
        "SWITCHED ON": [0x06, 0x07],
        "OPERATION ENABLED": [0x06, 0x07, 0x0F],
        "QUICK STOP ACTIVE": [0x06, 0x07, 0x0F, 0x02],
    }
    tried = 0
    for (start, end), word in State402.TRANSITIONTABLE.items():
        if start not in ways or end not in State402.SW_MASK or end == "FAULT REACTION ACTIVE":
            continue
        drive = DriveUnderTest()
        drive.write(0x605A, 6)
        drive.write(0x6060, VELOCITY)
        for step in ways[start]:
            drive.controlword(step, 5)
        mask, bits = State402.SW_MASK[end]
        assert drive.controlword(word, 50) & mask == bits, f"{start} to {end} by {word:04X}h"
        tried += 1
    assert tried >= 9
