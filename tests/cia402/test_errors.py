"""Errors of the simulated drive as a master sees them: EMCY, error register 1001h, statusword; frames as bytes."""

from __future__ import annotations

import pytest
from tests.canopen.device_under_test import DeviceUnderTest, Direct, DriveUnderTest, Station

EMCY = 0x085
START, STOP, PRE_OPERATIONAL = 1, 2, 128
LEFT_OPERATIONAL, OVER = "0081110000000000", "0000000081000000"
MASTER_LOST, MASTER_BACK = "3081117f00000000", "0000003081000000"
FAULT, DISABLED, STATE_BITS = 0x08, 0x40, 0x4F


@pytest.fixture
def drive() -> DriveUnderTest:
    """In OPERATION ENABLED and OPERATIONAL, watching the heartbeat of node 127; a fault switches off at once."""
    made = DriveUnderTest(wire=Direct()).started()
    made.write(0x605E, 0, 0, 2)
    made.write(0x1016, 1, 127 << 16 | 200, 4)
    made.send(0x77F, "05")
    for controlword in (0x06, 0x07, 0x0F):
        made.write(0x6040, 0, controlword, 2)
    assert made.read(0x6041) & STATE_BITS == 0x07
    made.frames()
    return made


def emergencies(frames: list[tuple[int, str]]) -> list[str]:
    return [data for can_id, data in frames if can_id == EMCY]


def state(drive: Station) -> int:
    return drive.read(0x6041) & STATE_BITS


def reset_fault(drive: Station) -> list[str]:
    """Controlword bit 7, and what the drive says to it besides the answers."""
    said = []
    for controlword in ("00", "80"):
        said += drive.send(0x605, f"2b406000{controlword}000000")
    return emergencies(said)


# -- NMT stop ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("next_state", [START, PRE_OPERATIONAL])
def test_nmt_stop_while_enabled_is_told_as_soon_as_the_drive_may_speak_and_so_is_its_end(
    drive: DriveUnderTest, next_state: int
) -> None:
    assert emergencies(drive.nmt(STOP)) == []
    assert emergencies(drive.after(100)) == []
    assert emergencies(drive.nmt(next_state)) == [LEFT_OPERATIONAL]
    assert (state(drive), drive.read(0x1001)) == (FAULT, 0x11)
    assert reset_fault(drive) == [OVER]
    assert (state(drive), drive.read(0x1001)) == (DISABLED, 0)


@pytest.mark.parametrize("option", [2, 3])
def test_nmt_stop_that_is_no_fault_by_6007h_is_over_when_the_drive_is_operational_again(
    drive: DriveUnderTest, option: int
) -> None:
    drive.write(0x6007, 0, option, 2)
    drive.nmt(STOP)
    assert emergencies(drive.nmt(START)) == [LEFT_OPERATIONAL, OVER]
    assert drive.read(0x1001) == 0


def test_pre_operational_while_enabled_is_told_at_once(drive: DriveUnderTest) -> None:
    assert emergencies(drive.nmt(PRE_OPERATIONAL)) == [LEFT_OPERATIONAL]
    assert reset_fault(drive) == [OVER]


@pytest.fixture
def dut(tmp_path) -> DeviceUnderTest:
    return DeviceUnderTest(tmp_path).started()


def test_an_error_that_comes_and_goes_in_stopped_is_not_told_at_all(dut: DeviceUnderTest) -> None:
    dut.nmt(STOP)
    dut.device.emergency(0x2310, 0x02)
    dut.device.clear_emergency(0x2310)
    assert emergencies(dut.nmt(START)) == []


def test_an_error_that_goes_in_stopped_is_told_to_be_over_afterwards(dut: DeviceUnderTest) -> None:
    dut.device.emergency(0x2310, 0x02)
    dut.device.emergency(0x4210, 0x08)
    dut.frames()
    dut.nmt(STOP)
    dut.device.clear_emergency(0x2310)
    assert emergencies(dut.nmt(START)) == ["0000091023000000"]


def test_what_is_pending_is_told_with_the_register_as_it_is_then(dut: DeviceUnderTest) -> None:
    dut.nmt(STOP)
    dut.device.emergency(0x2310, 0x02, b"\x07")
    dut.device.emergency(0x4210, 0x08)
    dut.device.clear_emergency(0x4210)
    assert emergencies(dut.nmt(START)) == ["1023030700000000"]


def test_an_error_that_was_told_goes_and_comes_again_in_stopped(dut: DeviceUnderTest) -> None:
    dut.device.emergency(0x2310, 0x02)
    dut.frames()
    dut.nmt(STOP)
    dut.device.clear_emergency(0x2310)
    dut.device.emergency(0x2310, 0x02)
    assert emergencies(dut.nmt(START)) == []
    dut.device.clear_emergency(0x2310)
    assert emergencies(dut.frames()) == ["0000001023000000"]


def test_the_inhibit_time_sends_nothing_in_stopped(dut: DeviceUnderTest) -> None:
    dut.after(0)
    dut.write(0x1015, 0, 100, 2)  # 10 ms
    dut.device.emergency(0x2310, 0x02)
    dut.device.emergency(0x4210, 0x08)
    assert len(dut.frames()) == 1
    dut.nmt(STOP)
    assert emergencies(dut.after(20)) == []
    dut.nmt(PRE_OPERATIONAL)
    assert emergencies(dut.after(1)) == ["10420b0000000000"]


def test_a_reset_forgets_what_is_pending(dut: DeviceUnderTest) -> None:
    dut.nmt(STOP)
    dut.device.emergency(0x2310, 0x02)
    assert emergencies(dut.nmt(129)) == []
    assert emergencies(dut.nmt(START)) == []


# -- a heartbeat that is lost and comes back ------------------------------------------------------------------


def test_a_drive_in_fault_keeps_its_error_though_the_master_is_back(drive: DriveUnderTest) -> None:
    assert emergencies(drive.after(201)) == [MASTER_LOST]
    assert emergencies(drive.send(0x77F, "05")) == []
    assert (state(drive), drive.read(0x1001), drive.read(0x603F)) == (FAULT, 0x11, 0x8130)
    assert reset_fault(drive) == [MASTER_BACK]
    assert (state(drive), drive.read(0x1001), drive.read(0x603F)) == (DISABLED, 0, 0)


def test_a_fault_reset_while_the_master_is_away_leaves_the_error_to_its_cause(drive: DriveUnderTest) -> None:
    drive.after(201)
    assert reset_fault(drive) == []
    assert (state(drive), drive.read(0x1001)) == (DISABLED, 0x11)
    assert emergencies(drive.send(0x77F, "05")) == [MASTER_BACK]
    assert drive.read(0x1001) == 0


def test_a_master_that_is_lost_again_during_the_fault_is_one_error(drive: DriveUnderTest) -> None:
    drive.after(201)
    drive.send(0x77F, "05")
    assert emergencies(drive.after(201)) == []
    assert reset_fault(drive) == []
    assert drive.read(0x1001) == 0x11
    assert emergencies(drive.send(0x77F, "05")) == [MASTER_BACK]


def test_a_quick_stop_by_6007h_is_no_fault_and_the_error_goes_with_its_cause(drive: DriveUnderTest) -> None:
    drive.write(0x6007, 0, 3, 2)
    assert emergencies(drive.after(201)) == [MASTER_LOST]
    assert state(drive) != FAULT
    assert emergencies(drive.send(0x77F, "05")) == [MASTER_BACK]


def test_the_error_of_another_fault_stays_until_the_fault_reset(drive: DriveUnderTest) -> None:
    assert emergencies(drive.send(0x605, "2b01200000730000")) == ["0073210000000000"]
    assert (state(drive), drive.read(0x1001)) == (FAULT, 0x21)
    assert reset_fault(drive) == ["0000000073000000"]
    assert drive.read(0x1001) == 0
