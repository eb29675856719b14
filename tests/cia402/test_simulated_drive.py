"""The simulated drive from outside: controlwords in, statusword, motor port and EMCY out."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cia402.stand_in import CYCLE_S, DriveUnderTest

from hilbench.can.frame import Frame
from hilbench.canopen.device import SdoAbort
from hilbench.cia402.state_machine import POWERED, State, decode_statusword
from hilbench.plant.motor_port import MotorMode

PV, TQ, HM, CSP, CSV, CST = 3, 4, 6, 8, 9, 10
RPM = 10_000
#: Statusword: bits that tell the state, with voltage (4) and remote (9).
DISABLED, READY, ON, ENABLED, QUICK, FAULT = 0x250, 0x231, 0x233, 0x237, 0x217, 0x218
STATE_BITS = 0x27F


@pytest.fixture
def drive() -> DriveUnderTest:
    return DriveUnderTest()


def running(mode: int = CSV, rpm: int = 500) -> DriveUnderTest:
    drive = DriveUnderTest()
    drive.enable(mode)
    drive.write(0x60FF, rpm * RPM)
    drive.cycle(500)
    assert drive.read(0x606C) == pytest.approx(rpm * RPM, rel=1e-3)
    return drive


class TestStateMachine:
    def test_up_and_down_with_the_statusword_of_each_step(self, drive: DriveUnderTest) -> None:
        assert drive.read(0x6041) == DISABLED
        steps = [
            (0x06, READY),  # 2
            (0x07, ON),  # 3
            (0x06, READY),  # 6
            (0x00, DISABLED),  # 7
            (0x06, READY),
            (0x02, DISABLED),  # 7 by quick stop
            (0x06, READY),
            (0x07, ON),
            (0x00, DISABLED),  # 10
            (0x06, READY),
            (0x0F, ENABLED),  # 3 and 4 by one controlword
            (0x07, ON),  # 5
            (0x0F, ENABLED),  # 4
            (0x06, READY),  # 8
            (0x0F, ENABLED),
            (0x00, DISABLED),  # 9
        ]
        for controlword, expected in steps:
            assert drive.controlword(controlword, cycles=2) & STATE_BITS == expected

    def test_quick_stop_reacts_and_switches_off(self) -> None:
        drive = running()
        assert drive.controlword(0x02) & STATE_BITS == QUICK  # 11
        drive.cycle(100)
        assert drive.read(0x6041) & STATE_BITS == DISABLED  # 12, automatic
        assert drive.read(0x606C) == pytest.approx(0, abs=RPM)

    def test_quick_stop_left_by_disable_voltage(self) -> None:
        drive = running()
        drive.controlword(0x02)
        assert drive.controlword(0x00) & STATE_BITS == DISABLED
        assert drive.port.mode is MotorMode.OFF

    def test_quick_stop_taken_back_where_the_drive_stays_in_it(self) -> None:
        drive = running()
        drive.write(0x605A, 6)
        drive.controlword(0x02, cycles=200)
        assert drive.read(0x6041) & (STATE_BITS | 1 << 10) == QUICK | 1 << 10
        assert drive.controlword(0x0F, cycles=20) & STATE_BITS == ENABLED  # 16
        assert drive.read(0x606C) == pytest.approx(500 * RPM, rel=1e-3)

    def test_quick_stop_not_taken_back_where_it_ends_in_switch_on_disabled(self) -> None:
        drive = running()
        drive.controlword(0x02)
        assert drive.controlword(0x0F) & STATE_BITS == QUICK

    def test_fault_and_reset(self) -> None:
        drive = running()
        drive.write(0x2001, 0x7300)
        assert decode_statusword(drive.read(0x6041)) is State.FAULT_REACTION_ACTIVE  # 13
        drive.cycle(100)
        assert drive.read(0x6041) & STATE_BITS == FAULT  # 14
        assert (drive.read(0x603F), drive.emergency_codes()) == (0x7300, [0x7300])
        assert drive.controlword(0x0F) & STATE_BITS == FAULT
        assert drive.controlword(0x80) & STATE_BITS == DISABLED  # 15
        assert (drive.read(0x603F), drive.emergency_codes()) == (0, [0x7300, 0])

    def test_reset_needs_an_edge(self) -> None:
        drive = running()
        drive.controlword(0x8F)
        assert drive.drive.state is State.OPERATION_ENABLED
        drive.write(0x2001, 0x7300)
        drive.cycle(100)
        assert drive.controlword(0x8F) & STATE_BITS == FAULT
        drive.controlword(0x0F)
        assert drive.controlword(0x8F) & STATE_BITS == DISABLED

    @settings(max_examples=150, deadline=None)
    @given(
        st.lists(
            st.tuples(
                st.sampled_from([0x00, 0x02, 0x06, 0x07, 0x0F, 0x80, 0x8F, 0x86, 0x10F, 0x1F]) | st.integers(0, 0xFFFF),
                st.integers(0, 3),
                st.booleans(),
            ),
            max_size=25,
        )
    )
    def test_power_only_by_the_legal_path(self, script: list[tuple[int, int, bool]]) -> None:
        drive = DriveUnderTest()
        drive.write(0x6060, CSV)
        drive.write(0x60FF, 300 * RPM)
        state = drive.drive.state
        for controlword, cycles, fails in script:
            if fails:
                drive.write(0x2001, 0x7300)
                state = drive.drive.state
            drive.write(0x6040, controlword)
            if drive.drive.state is State.OPERATION_ENABLED and state is not State.OPERATION_ENABLED:
                assert state in (State.SWITCHED_ON, State.READY_TO_SWITCH_ON)
                assert controlword & 0x8F == 0x0F
            for _ in range(cycles):
                before = drive.drive.state
                drive.cycle()
                # Left alone, a drive never gains power.
                assert not (drive.drive.state in POWERED and before not in POWERED)
            state = drive.drive.state
            assert (drive.port.mode is MotorMode.OFF) or state in POWERED
            assert decode_statusword(drive.read(0x6041)) is state


class TestOptionCodes:
    @pytest.mark.parametrize(
        ("code", "slope_rpm_s", "stays"),
        [
            *[(1, 1000, False), (2, 3000, False), (3, None, False), (4, None, False)],
            *[(5, 1000, True), (6, 3000, True), (7, None, True), (8, None, True)],
        ],
    )
    def test_quick_stop(self, code: int, slope_rpm_s: int | None, stays: bool) -> None:
        drive = running()
        drive.write(0x605A, code)
        drive.controlword(0x02)
        assert drive.slope_rpm_s() == (slope_rpm_s and pytest.approx(slope_rpm_s))
        drive.cycle(400)
        assert drive.read(0x6041) & STATE_BITS == (QUICK if stays else DISABLED)

    def test_quick_stop_0_coasts(self) -> None:
        drive = running()
        drive.write(0x605A, 0)
        assert drive.controlword(0x02) & STATE_BITS == DISABLED
        assert drive.read(0x606C) == pytest.approx(500 * RPM, rel=1e-3)

    @pytest.mark.parametrize(("index", "controlword", "end"), [(0x605B, 0x06, READY), (0x605C, 0x07, ON)])
    def test_shutdown_and_disable_ramp_or_coast(self, index: int, controlword: int, end: int) -> None:
        drive = running()
        drive.write(index, 1)
        assert drive.controlword(controlword) & STATE_BITS == ENABLED
        assert drive.slope_rpm_s() == pytest.approx(1000)
        drive.cycle(300)
        assert drive.read(0x6041) & STATE_BITS == end
        assert abs(drive.read(0x606C)) < 5 * RPM

        drive = running()
        drive.write(index, 0)
        assert drive.controlword(controlword) & STATE_BITS == end
        assert drive.read(0x606C) == pytest.approx(500 * RPM, rel=1e-3)

    def test_disabling_ramp_taken_back(self) -> None:
        drive = running()
        drive.controlword(0x07, cycles=50)
        assert drive.read(0x606C) < 450 * RPM
        drive.controlword(0x0F, cycles=50)
        assert drive.read(0x606C) == pytest.approx(500 * RPM, rel=1e-3)
        assert drive.drive.state is State.OPERATION_ENABLED

    @pytest.mark.parametrize(("code", "slope_rpm_s"), [(1, 1000), (2, 3000), (3, None), (4, None)])
    def test_halt(self, code: int, slope_rpm_s: int | None) -> None:
        drive = running()
        drive.write(0x605D, code)
        drive.controlword(0x10F)
        assert drive.slope_rpm_s() == (slope_rpm_s and pytest.approx(slope_rpm_s))
        assert drive.read(0x6041) & 1 << 12 == 0
        drive.cycle(400)
        assert drive.read(0x6041) & (STATE_BITS | 1 << 10) == ENABLED | 1 << 10
        drive.controlword(0x0F, cycles=50)
        assert drive.read(0x606C) == pytest.approx(500 * RPM, rel=1e-3)

    @pytest.mark.parametrize(("code", "slope_rpm_s"), [(1, 1000), (2, 3000), (3, None), (4, None)])
    def test_fault_reaction(self, code: int, slope_rpm_s: int | None) -> None:
        drive = running()
        drive.write(0x605E, code)
        drive.write(0x2001, 0x5441)
        drive.cycle()
        assert drive.slope_rpm_s() == (slope_rpm_s and pytest.approx(slope_rpm_s))
        drive.cycle(400)
        assert drive.read(0x6041) & STATE_BITS == FAULT

    def test_fault_reaction_0_coasts(self) -> None:
        drive = running()
        drive.write(0x605E, 0)
        drive.write(0x2001, 0x5441)
        assert drive.read(0x6041) & STATE_BITS == FAULT
        assert drive.port.mode is MotorMode.OFF

    @pytest.mark.parametrize(
        ("code", "end"), [(0, ENABLED), (1, FAULT), (2, DISABLED), (3, DISABLED)], ids=["none", "fault", "off", "quick"]
    )
    @pytest.mark.parametrize("cause", ["communication error", "NMT"])
    def test_abort_connection(self, code: int, end: int, cause: str) -> None:
        drive = running()
        drive.write(0x6007, code)
        drive.lose_master(nmt=cause == "NMT")
        drive.cycle(100)
        assert drive.read(0x6041) & STATE_BITS == end

    def test_torque_mode_stops_by_the_torque_slope(self, drive: DriveUnderTest) -> None:
        drive.enable(CST)
        drive.write(0x6071, 500)
        drive.cycle(5)
        drive.controlword(0x02)
        assert drive.port.mode is MotorMode.TORQUE
        assert drive.read(0x6077) == pytest.approx(500 - 10_000 * CYCLE_S, abs=1)
        drive.cycle(30)
        assert drive.read(0x6041) & STATE_BITS == DISABLED


class TestModes:
    @pytest.mark.parametrize("mode", [1, 2, 5, 7, 11, -1, 99])
    def test_unsupported_modes_are_refused(self, drive: DriveUnderTest, mode: int) -> None:
        with pytest.raises(SdoAbort):
            drive.write(0x6060, mode)
        assert drive.read(0x6061) == 0

    @pytest.mark.parametrize("mode", [PV, TQ, HM, CSP, CSV, CST])
    def test_supported_modes_are_shown(self, drive: DriveUnderTest, mode: int) -> None:
        drive.write(0x6060, mode)
        assert drive.read(0x6061) == mode

    def test_csv_follows_at_once_with_offset(self) -> None:
        drive = running(CSV, 100)
        drive.write(0x60B1, 50 * RPM)
        drive.cycle(5)
        assert drive.read(0x606C) == pytest.approx(150 * RPM, rel=1e-3)
        assert drive.read(0x6041) & 1 << 12

    def test_pv_ramps_and_reports(self, drive: DriveUnderTest) -> None:
        drive.enable(PV)
        drive.cycle(10)
        assert drive.read(0x6041) & (1 << 12 | 1 << 10) == 1 << 12 | 1 << 10  # at rest, and asked to be
        drive.write(0x60FF, 200 * RPM)
        drive.cycle(50)
        assert drive.read(0x606B) == pytest.approx(100 * RPM, rel=0.01)  # 1000 rpm/s for 0.1 s
        assert drive.read(0x6041) & (1 << 12 | 1 << 10) == 0
        drive.cycle(70)
        assert drive.read(0x6041) & 1 << 10
        drive.write(0x6084, 500 * RPM)
        drive.write(0x60FF, 0)
        drive.cycle(100)
        assert drive.read(0x606B) == pytest.approx(100 * RPM, rel=0.01)

    def test_pv_reverses_by_the_deceleration_first(self) -> None:
        drive = running(PV, 100)
        drive.write(0x6084, 500 * RPM)
        drive.write(0x60FF, -100 * RPM)
        drive.cycle(50)
        assert drive.read(0x606B) == pytest.approx(50 * RPM, rel=0.01)
        drive.cycle(50 + 25)
        assert drive.read(0x606B) == pytest.approx(-50 * RPM, rel=0.02)

    def test_torque_mode_ramps_and_reports(self, drive: DriveUnderTest) -> None:
        drive.enable(TQ)
        drive.write(0x6071, 100)
        drive.cycle(2)
        assert drive.read(0x6074) == 40  # 10 000 per mille a second
        assert drive.read(0x6041) & 1 << 10 == 0
        drive.cycle(4)
        assert (drive.read(0x6074), drive.read(0x6077)) == (100, 100)
        assert drive.read(0x6041) & 1 << 10

    def test_cst_follows_at_once(self, drive: DriveUnderTest) -> None:
        drive.enable(CST)
        drive.write(0x6071, 100)
        drive.write(0x60B2, 20)
        drive.cycle()
        assert drive.port.setpoint == pytest.approx(0.6)  # 120 per mille of 5 N·m
        assert drive.read(0x6077) == 120

    def test_csp_interpolates_over_the_period(self, drive: DriveUnderTest) -> None:
        drive.write(0x60C2, 10, 1)  # 10 ms: five cycles
        drive.enable(CSP)
        drive.write(0x607A, 20_000)
        drive.cycle()
        assert drive.read(0x6062) == pytest.approx(4_000, rel=0.01)

    def test_csp_follows_a_counter_that_wraps(self, drive: DriveUnderTest) -> None:
        drive.motor.port.position_rad = (2**31 - 10_000) * 2.0 * 3.141592653589793 / 2**20
        drive.cycle()
        drive.write(0x607A, drive.read(0x6064))
        drive.enable(CSP)
        target = 2**31 - 10_000
        for _ in range(20):
            target += 2_000
            drive.write(0x607A, (target + 2**31) % 2**32 - 2**31)
            drive.cycle()
        drive.cycle(5)
        assert drive.read(0x6064) == pytest.approx(-(2**31) + 30_000, abs=100)
        assert drive.read(0x6041) & STATE_BITS == ENABLED

    @pytest.mark.parametrize("method", [35, 37])
    def test_homing_takes_the_present_position(self, drive: DriveUnderTest, method: int) -> None:
        drive.motor.port.position_rad = 12.0
        drive.write(0x6098, method)
        drive.write(0x607C, 1234)
        drive.enable(HM)
        assert drive.read(0x6041) & 0x3400 == 0x0400
        assert drive.controlword(0x1F) & 0x3400 == 0x1400
        assert drive.read(0x6064) == 1234

    def test_homing_of_a_moving_motor_is_an_error(self) -> None:
        drive = running(CSV, 100)
        drive.write(0x6060, HM)
        drive.cycle()
        assert drive.controlword(0x1F) & 0x3400 == 0x2000
        drive.cycle(200)
        assert drive.read(0x6041) & 0x3400 == 0x2400

    def test_other_homing_methods_are_refused(self, drive: DriveUnderTest) -> None:
        with pytest.raises(SdoAbort):
            drive.write(0x6098, 1)

    def test_mode_changes_while_enabled(self) -> None:
        drive = running(CSV, 100)
        drive.write(0x6060, CST)
        drive.write(0x6071, 0)
        drive.cycle()
        assert drive.read(0x6061) == CST
        assert drive.port.mode is MotorMode.TORQUE


class TestLimits:
    @pytest.mark.parametrize(("index", "value"), [(0x607F, 300 * RPM), (0x6080, 300)])
    def test_velocity_is_limited(self, index: int, value: int) -> None:
        drive = running(CSV, 200)
        drive.write(index, value)
        drive.write(0x60FF, -1000 * RPM)
        drive.cycle(100)
        assert drive.read(0x606C) == pytest.approx(-300 * RPM, rel=1e-3)
        assert drive.read(0x6041) & 1 << 11
        drive.write(0x60FF, 100 * RPM)
        drive.cycle(50)
        assert drive.read(0x6041) & 1 << 11 == 0

    def test_torque_is_limited(self, drive: DriveUnderTest) -> None:
        drive.write(0x6072, 200)
        drive.enable(CST)
        drive.write(0x6071, -900)
        drive.cycle()
        assert drive.read(0x6077) == -200
        assert drive.read(0x6041) & 1 << 11

    def test_torque_limit_of_the_velocity_loop(self, drive: DriveUnderTest) -> None:
        drive.write(0x6072, 200)
        drive.enable(CSV)
        drive.write(0x60FF, 1000 * RPM)
        drive.cycle(3)
        assert drive.read(0x6077) == 200
        assert drive.read(0x6041) & 1 << 11

    def test_overspeed(self, drive: DriveUnderTest) -> None:
        drive.write(0x6080, 100)
        drive.enable(CST)
        drive.write(0x6071, 1000)
        drive.cycle(20)
        assert drive.read(0x603F) == 0x84FF
        drive.cycle(60)
        assert drive.read(0x6041) & STATE_BITS == FAULT
        assert drive.controlword(0x80) & STATE_BITS == FAULT, "still too fast"
        drive.port.velocity_rad_s = 0.0
        drive.controlword(0x00)
        assert drive.controlword(0x80) & STATE_BITS == DISABLED

    def test_following_error(self, drive: DriveUnderTest) -> None:
        drive.enable(CSP)
        drive.motor.blocked = True
        drive.write(0x6065, 1_000)
        drive.write(0x607A, 5_000)
        drive.cycle(3)
        assert drive.read(0x60F4) == 5_000
        assert drive.read(0x6041) & (STATE_BITS | 1 << 13) == ENABLED | 1 << 13
        drive.cycle(10)  # 6066h: 10 ms
        assert drive.read(0x603F) == 0x8611
        drive.cycle(5)
        assert drive.read(0x6041) & STATE_BITS == FAULT

    def test_following_error_window_switched_off(self, drive: DriveUnderTest) -> None:
        drive.enable(CSP)
        drive.motor.blocked = True
        drive.write(0x6065, 0xFFFF_FFFF)
        drive.write(0x607A, 2**30)
        drive.cycle(50)
        assert drive.read(0x6041) & STATE_BITS == ENABLED


def test_nmt_reset_is_a_power_on() -> None:
    drive = running()
    drive.device.handle(Frame(0, bytes([129, 1])))
    assert drive.read(0x6041) == DISABLED
    assert (drive.read(0x6060), drive.read(0x6061)) == (0, 0)
    assert drive.port.mode is MotorMode.OFF


def test_a_lost_heartbeat_is_not_taken_back_by_the_drive() -> None:
    drive = running()
    drive.lose_master(nmt=False)
    drive.cycle(100)
    drive.controlword(0x80)
    assert drive.read(0x6041) & STATE_BITS == DISABLED
    assert drive.emergency_codes() == []
