"""Profile position, interpolated position and velocity mode of the simulated drive, as a master sees them."""

from math import pi

import pytest
from tests.cia402.every_mode import INCREMENTS, EveryMode

PP, VL, IP, CSP = 1, 2, 7, 8
ENABLED, NEW, AT_ONCE, RELATIVE, HALT, THROUGH = 0x0F, 0x10, 0x20, 0x40, 0x100, 0x200
REACHED, ACKNOWLEDGED, LIMITED = 1 << 10, 1 << 12, 1 << 11


@pytest.fixture
def drive() -> EveryMode:
    drive = EveryMode()
    drive.enable(PP)
    return drive


def set_point(drive: EveryMode, turns: float, bits: int = 0) -> int:
    """The handshake of one set-point; the statusword while bit 4 is set."""
    drive.write(0x607A, round(turns * INCREMENTS))
    status = drive.controlword(ENABLED | NEW | bits)
    drive.controlword(ENABLED | bits & ~NEW)
    return status


class TestProfilePosition:
    def test_a_set_point_is_acknowledged_approached_by_its_profile_and_reached(self, drive: EveryMode) -> None:
        drive.write(0x607A, 3 * INCREMENTS)
        assert drive.controlword(ENABLED | NEW) & (ACKNOWLEDGED | REACHED) == ACKNOWLEDGED
        assert drive.controlword(ENABLED) & (ACKNOWLEDGED | REACHED) == 0
        # 600 rpm = 10 turns/s: 3 turns take 0.3 s, and 0.05 s and 0.1 s more by ramps of 6000 and 3000 rpm/s
        assert drive.seconds(0.1) & REACHED == 0
        assert drive.read(0x606C) == pytest.approx(600, abs=2)
        assert drive.seconds(0.45 - 0.1 - 0.02) & REACHED == 0
        assert drive.seconds(0.06) & REACHED
        assert drive.read(0x6064) == pytest.approx(3 * INCREMENTS, abs=20)

    def test_a_profile_velocity_of_zero_moves_nothing(self, drive: EveryMode) -> None:
        drive.write(0x6081, 0)
        set_point(drive, 2.0)
        assert drive.seconds(1.0) & REACHED == 0
        assert drive.read(0x6064) == 0

    def test_one_set_point_can_wait_and_a_third_is_not_taken(self, drive: EveryMode) -> None:
        set_point(drive, 2.0)
        assert set_point(drive, -1.0) & ACKNOWLEDGED
        assert drive.read(0x6041) & ACKNOWLEDGED, "no room: the acknowledge stays"
        set_point(drive, 7.0)
        furthest = 0.0
        for _ in range(500):
            drive.cycle()
            furthest = max(furthest, drive.turns)
        assert furthest == pytest.approx(2.0, abs=0.01)
        assert drive.turns == pytest.approx(-1.0, abs=0.01)
        assert drive.read(0x6041) & (REACHED | ACKNOWLEDGED) == REACHED

    def test_a_set_point_at_once_replaces_the_one_that_is_approached(self, drive: EveryMode) -> None:
        set_point(drive, 20.0)
        drive.seconds(0.2)
        set_point(drive, 0.5, AT_ONCE)
        assert drive.seconds(1.5) & REACHED
        assert drive.turns == pytest.approx(0.5, abs=0.01)

    def test_a_relative_set_point_counts_from_the_last_target(self, drive: EveryMode) -> None:
        set_point(drive, 1.0)
        drive.seconds(0.1)
        set_point(drive, 0.5, RELATIVE)
        drive.seconds(1.0)
        assert drive.turns == pytest.approx(1.5, abs=0.01)
        set_point(drive, -0.25, RELATIVE)
        drive.seconds(1.0)
        assert drive.turns == pytest.approx(1.25, abs=0.01)

    def test_a_target_is_passed_with_the_end_velocity_until_another_comes(self, drive: EveryMode) -> None:
        drive.write(0x6082, 120)
        set_point(drive, 3.0)
        drive.seconds(0.6)
        assert drive.turns > 3.0
        assert drive.read(0x606C) == pytest.approx(120, abs=2)
        before = drive.turns
        assert drive.seconds(0.5) & REACHED
        assert drive.turns - before == pytest.approx(2.0 * 0.5, abs=0.01)
        drive.write(0x6082, 0)
        set_point(drive, 0.0, AT_ONCE)
        assert drive.seconds(2.0) & REACHED
        assert drive.turns == pytest.approx(0.0, abs=0.01)

    def test_an_end_velocity_ends_at_the_software_limit(self, drive: EveryMode) -> None:
        drive.write(0x607D, -5 * INCREMENTS, sub=1)
        drive.write(0x607D, 4 * INCREMENTS, sub=2)
        drive.write(0x6082, 300)
        set_point(drive, 3.0)
        assert drive.seconds(2.0) & LIMITED
        assert drive.turns == pytest.approx(4.0, abs=0.01)

    def test_with_bit_9_the_first_of_two_is_gone_through_without_a_stop(self) -> None:
        slowest = {}
        for bits in (0, THROUGH):
            drive = EveryMode()
            drive.enable(PP)
            set_point(drive, 2.0)
            set_point(drive, 4.0, bits)
            speeds = []
            while drive.turns < 3.9 and len(speeds) < 1000:
                drive.cycle()
                if drive.turns > 1.0:
                    speeds.append(drive.port.velocity_rad_s)
            slowest[bits] = min(speeds[:-60])
            drive.seconds(1.0)
            assert drive.turns == pytest.approx(4.0, abs=0.01)
        assert slowest[0] == pytest.approx(0.0, abs=1.0)
        assert slowest[THROUGH] > 0.9 * 600 * 2 * pi / 60

    def test_a_halt_interrupts_and_the_way_goes_on_after_it(self, drive: EveryMode) -> None:
        set_point(drive, 5.0)
        drive.seconds(0.1)
        assert drive.controlword(ENABLED | HALT, cycles=200) & REACHED
        halted = drive.turns
        assert halted < 4.0
        drive.controlword(ENABLED | HALT, cycles=50)
        assert drive.turns == pytest.approx(halted, abs=0.01)
        drive.controlword(ENABLED)
        assert drive.seconds(1.5) & REACHED
        assert drive.turns == pytest.approx(5.0, abs=0.01)

    def test_a_target_beyond_the_software_limit_ends_at_it(self, drive: EveryMode) -> None:
        drive.write(0x607D, -INCREMENTS, sub=1)
        drive.write(0x607D, 2 * INCREMENTS, sub=2)
        drive.cycle()
        set_point(drive, 5.0)
        assert drive.seconds(1.0) & LIMITED
        assert drive.turns == pytest.approx(2.0, abs=0.01)

    def test_enabled_anew_it_stays_where_it_is(self, drive: EveryMode) -> None:
        set_point(drive, 5.0)
        drive.seconds(0.2)
        drive.controlword(0x07, cycles=200)
        here = drive.turns
        drive.controlword(ENABLED)
        drive.seconds(0.5)
        assert drive.turns == pytest.approx(here, abs=0.02)


class TestInterpolatedPosition:
    def test_it_follows_while_bit_4_is_set_and_stays_else(self) -> None:
        drive = EveryMode()
        drive.enable(IP)
        drive.write(0x60C1, 500, sub=1)
        assert drive.seconds(0.05) & ACKNOWLEDGED == 0
        assert drive.read(0x6064) == 0
        for target in range(0, 2000, 20):
            drive.write(0x60C1, target, sub=1)
            assert drive.controlword(ENABLED | NEW) & ACKNOWLEDGED
        drive.seconds(0.02)
        assert drive.read(0x6064) == pytest.approx(1980, abs=5)
        drive.controlword(ENABLED)
        drive.write(0x60C1, 0, sub=1)
        drive.seconds(0.05)
        assert drive.read(0x6064) == pytest.approx(1980, abs=5)


class TestVelocity:
    def test_it_ramps_by_6048h_and_6049h_in_rpm(self) -> None:
        drive = EveryMode()
        drive.enable(VL)
        drive.write(0x6042, 1200)
        drive.controlword(0x7F)
        drive.seconds(0.6)
        assert drive.read(0x6044) == pytest.approx(600, abs=10)  # 2000 rpm in 2 s
        assert drive.read(0x6043) == pytest.approx(600, abs=10)
        drive.seconds(0.7)
        assert drive.read(0x6044) == 1200
        drive.write(0x6042, 0)
        drive.seconds(0.3)
        assert drive.read(0x6044) == pytest.approx(600, abs=10)  # 4000 rpm in 2 s

    def test_the_ramp_is_stopped_locked_and_set_to_zero_by_its_bits(self) -> None:
        drive = EveryMode()
        drive.enable(VL)
        drive.write(0x6042, 1000)
        drive.controlword(0x0F, cycles=100)
        assert drive.read(0x6044) == 0, "bit 4: no ramp"
        drive.controlword(0x7F)
        drive.seconds(0.5)
        drive.controlword(0x5F, cycles=200)  # locked
        locked = drive.read(0x6044)
        assert 400 < locked < 600
        drive.controlword(0x3F, cycles=600)  # its input is 0
        assert drive.read(0x6044) == 0

    def test_amounts_of_6046h_bound_the_target(self) -> None:
        drive = EveryMode()
        drive.enable(VL)
        drive.write(0x6046, 200, sub=1)
        drive.write(0x6046, 500, sub=2)
        drive.write(0x6042, -2000)
        assert drive.controlword(0x7F, cycles=500) & LIMITED
        assert drive.read(0x6044) == -500
        drive.write(0x6042, -10)
        drive.seconds(1.0)
        assert drive.read(0x6044) == -200


@pytest.mark.parametrize("mode", [PP, VL, IP, CSP])
def test_a_drive_whose_file_lacks_parameters_moves_all_the_same(mode: int) -> None:
    without = (0x6007, 0x6046, 0x6048, 0x6049, 0x6065, 0x6067, 0x6068, 0x6081, 0x6083, 0x6084, 0x60C2, 0x6502)
    drive = EveryMode(without=without)
    drive.enable(mode)
    drive.write(0x6042, 100)
    target = 0
    for _ in range(400):
        target += 10
        drive.write(0x607A, target)
        drive.write(0x60C1, target, sub=1)
        anew = 0x2F if drive.read(0x6040) == 0x3F else 0x3F
        drive.controlword({PP: anew, VL: 0x7F}.get(mode, 0x1F))
    assert drive.turns > 0.2
