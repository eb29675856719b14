"""Touch probes: positions at edges of an input and at the index pulse, once or continuously."""

from math import pi

import pytest
from tests.cia402.every_mode import INCREMENTS, EveryMode

from hilbench.cia402.switches import Switches, Zone

TURN = 2.0 * pi
PROBE1, PROBE2 = Zone(0.3 * TURN, 0.6 * TURN), Zone(1.3 * TURN, 1.6 * TURN)


@pytest.fixture
def drive() -> EveryMode:
    return EveryMode(Switches(probes=(PROBE1, PROBE2)))


def move(drive: EveryMode, *turns: float) -> None:
    """From place to place in small steps, as a hand turns it."""
    for target in turns:
        here = drive.turns
        for k in range(1, 201):
            drive.start_at(here + (target - here) * k / 200)


def test_edges_of_both_inputs_are_stored_with_their_positions(drive: EveryMode) -> None:
    drive.write(0x60B8, 0x3131)
    move(drive, 2.0)
    assert drive.read(0x60B9) == 0x0707
    edges = [drive.read(index) / INCREMENTS for index in (0x60BA, 0x60BB, 0x60BC, 0x60BD)]
    assert edges == pytest.approx([0.3, 0.6, 1.3, 1.6], abs=0.011)


def test_the_first_event_counts_unless_it_is_asked_for_continuously(drive: EveryMode) -> None:
    drive.write(0x60B8, 0x11)
    move(drive, 1.0, 0.0, 1.0)
    first = drive.read(0x60BA)
    move(drive, 0.0)
    assert drive.read(0x60BA) == first
    drive.write(0x60B8, 0x00)
    move(drive, 0.01)
    assert drive.read(0x60B9) == 0
    drive.write(0x60B8, 0x13)
    move(drive, 1.0)
    drive.write(0x60B8, 0x13)
    move(drive, 0.4)  # into it from the other side: a positive edge at 0.6
    assert drive.read(0x60BA) / INCREMENTS == pytest.approx(0.6, abs=0.011)


def test_the_index_pulse_is_exact(drive: EveryMode) -> None:
    drive.write(0x60B8, 0x15)
    move(drive, 1.4)
    assert (drive.read(0x60B9), drive.read(0x60BA)) == (0x03, INCREMENTS)


def test_what_was_not_asked_for_is_not_stored(drive: EveryMode) -> None:
    drive.write(0x60B8, 0x21)
    move(drive, 0.5)
    assert drive.read(0x60B9) == 0x01
    move(drive, 0.7)
    assert drive.read(0x60B9) == 0x05
