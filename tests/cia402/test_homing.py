"""Homing by switches and index pulse: each method against the edge that the standard's figures show."""

from math import inf, pi

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cia402.every_mode import INCREMENTS, EveryMode

from hilbench.canopen.device import SdoAbort
from hilbench.cia402.switches import Switches, Zone

TURN = 2.0 * pi
HOMING, ENABLED, START = 6, 0x0F, 0x10
REACHED, ATTAINED, FAILED = 1 << 10, 1 << 12, 1 << 13
LOW, HIGH, LEFT, RIGHT = -3.4, 4.3, 1.2, 1.7  #: turns: limit switches, and the edges of the home switch
HOME_OFFSET = 500

#: IEC 61800-7-201, homing methods: the edge, and where the index pulse lies from it (turns).
BY_INDEX = {
    1: -3.0, 2: 4.0, 3: 1.0, 4: 2.0, 5: 2.0, 6: 1.0,
    7: 1.0, 8: 2.0, 9: 1.0, 10: 2.0, 11: 2.0, 12: 1.0, 13: 2.0, 14: 1.0,
}  # fmt: skip
#: Switches that are active from their edge on to the end of the way: methods 3, 4 and 5, 6.
POSITIVE, NEGATIVE = Zone(LEFT * TURN, inf), Zone(-inf, RIGHT * TURN)
AT_EDGE = {
    17: LOW, 18: HIGH, 19: LEFT, 20: LEFT, 21: RIGHT, 22: RIGHT,
    23: LEFT, 24: LEFT, 25: RIGHT, 26: RIGHT, 27: RIGHT, 28: RIGHT, 29: LEFT, 30: LEFT,
}  # fmt: skip


def with_switches(method: int) -> Switches:
    kind = method - 16 if method > 16 else method
    home = POSITIVE if kind in (3, 4) else NEGATIVE if kind in (5, 6) else Zone(LEFT * TURN, RIGHT * TURN)
    return Switches(negative_limit=Zone(-inf, LOW * TURN), positive_limit=Zone(HIGH * TURN, inf), home=home)


def homed(method: int, start: float) -> tuple[EveryMode, float]:
    """After homing from there: the drive, and where (turns as the encoder counts them) its home position is."""
    drive = EveryMode(with_switches(method))
    drive.start_at(start)
    drive.enable(HOMING)
    drive.write(0x6098, method)
    status = drive.controlword(ENABLED | START)
    for _ in range(40_000):
        if status & (ATTAINED | FAILED) and status & REACHED:
            break
        drive.cycle()
        status = drive.read(0x6041)
    assert status & (ATTAINED | FAILED | REACHED) == ATTAINED | REACHED
    home = drive.turns - (drive.read(0x6064) - HOME_OFFSET) / INCREMENTS
    return drive, home


@settings(max_examples=8, deadline=None)
@given(st.floats(LOW + 0.05, HIGH - 0.05))
@pytest.mark.parametrize("method", BY_INDEX)
def test_home_is_the_index_pulse_that_the_method_names_wherever_it_starts(method: int, start: float) -> None:
    assert homed(method, start)[1] == pytest.approx(BY_INDEX[method], abs=2 / INCREMENTS)


@settings(max_examples=8, deadline=None)
@given(st.floats(LOW + 0.05, HIGH - 0.05))
@pytest.mark.parametrize("method", AT_EDGE)
def test_home_is_the_edge_that_the_method_names_wherever_it_starts(method: int, start: float) -> None:
    # seen once a cycle, at 30 rpm: within a thousandth of a turn, and what the switch moves on in that cycle
    assert homed(method, start)[1] == pytest.approx(AT_EDGE[method], abs=0.003)


@pytest.mark.parametrize(
    ("method", "start", "home"), [(33, 0.4, 0.0), (34, 0.4, 1.0), (33, -0.4, -1.0), (34, -0.4, 0.0)]
)
def test_the_next_index_pulse_in_one_direction(method: int, start: float, home: float) -> None:
    assert homed(method, start)[1] == pytest.approx(home, abs=2 / INCREMENTS)


def test_while_it_searches_the_statusword_says_so_and_bit_4_ends_it() -> None:
    drive = EveryMode(with_switches(1))
    drive.enable(HOMING)
    drive.write(0x6098, 1)
    drive.controlword(ENABLED | START)
    assert drive.seconds(0.1) & (REACHED | ATTAINED | FAILED) == 0
    assert drive.port.velocity_rad_s == pytest.approx(-600 * 2 * pi / 60, rel=0.01)
    drive.controlword(ENABLED)
    drive.seconds(0.2)
    assert drive.read(0x6041) & (ATTAINED | FAILED) == 0
    assert drive.port.velocity_rad_s == pytest.approx(0.0, abs=0.1)


def test_without_a_home_switch_between_the_limits_it_is_an_error() -> None:
    drive = EveryMode(Switches(negative_limit=Zone(-inf, LOW * TURN), positive_limit=Zone(HIGH * TURN, inf)))
    drive.enable(HOMING)
    drive.write(0x6098, 7)
    drive.controlword(ENABLED | START)
    assert drive.seconds(5.0) & (ATTAINED | FAILED | REACHED) == FAILED | REACHED


def test_a_drive_without_switches_refuses_the_methods_that_need_them() -> None:
    drive = EveryMode()
    for method in (1, 7, 17, 33):
        with pytest.raises(SdoAbort):
            drive.write(0x6098, method)
    drive.write(0x6098, 37)


def test_inputs_show_in_60fdh() -> None:
    drive = EveryMode(with_switches(7))
    shown = {}
    for turns in (-4.0, 0.0, 1.5, 5.0):
        drive.start_at(turns)
        shown[turns] = drive.read(0x60FD)
    assert shown == {-4.0: 1, 0.0: 0, 1.5: 4, 5.0: 2}
