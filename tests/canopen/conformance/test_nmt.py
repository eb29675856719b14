"""NMT cases of the conformance test: states and the services that change them, seen by heartbeats."""

from __future__ import annotations

import pytest
from tests.canopen.device_under_test import DriveUnderTest

case = pytest.mark.case

START, STOP, ENTER_PRE_OPERATIONAL, RESET_NODE, RESET_COMMUNICATION = 1, 2, 128, 129, 130
BOOT_UP = (0x705, "00")
OPERATIONAL, STOPPED, PRE_OPERATIONAL = "05", "04", "7f"
TPDO1 = (0x185, "5002000000000000")
TPDO2 = (0x285, "00000000")
DEVICE_TYPE = (0x585, "4300100092010200")


def with_heartbeat(drive: DriveUnderTest) -> DriveUnderTest:
    assert drive.sdo("2b 17 10 00 f4010000") == "6017100000000000"
    return drive


def state(drive: DriveUnderTest) -> str:
    [(can_id, data)] = drive.after(500)
    assert can_id == 0x705
    return data


def read_device_type(drive: DriveUnderTest) -> list[tuple[int, str]]:
    return drive.send(0x605, "4000100000000000")


def set_velocity_by_rpdo(drive: DriveUnderTest) -> str:
    """What stands in 60FFh after an RPDO with 10 000 and a SYNC."""
    drive.send(0x205, "000010270000")
    drive.sync()
    return f"{drive.device.cell(0x60FF).value}"


@case("NMT 1")
def test_boot_up_with_default_values(drive: DriveUnderTest) -> None:
    kinds = ("rw", "rww")
    areas = [cell for cell in drive.od.indices if 0x1000 <= cell <= 0x1FFF]
    assert areas
    defaults = {index: drive.upload(index, 0) for index in areas}
    changes = {0x1005: (0x90, 4), 0x1006: (7, 4), 0x1007: (7, 4), 0x1015: (7, 2), 0x1017: (500, 2)}
    for index, (value, size) in changes.items():
        assert drive.write(index, 0, value, size) == 0
        assert drive.od[index].access_type in kinds
    assert drive.write(0x1016, 1, 0x00070064, 4) == 0
    assert drive.write(0x1800, 1, 0xC0000185, 4) == 0
    assert drive.nmt(RESET_NODE) == [BOOT_UP]
    assert {index: drive.upload(index, 0) for index in areas} == defaults
    assert (drive.read(0x1016, 1), drive.read(0x1800, 1)) == (0, 0x40000185)
    assert state(with_heartbeat(drive)) == PRE_OPERATIONAL


@case("NMT 2")
def test_pre_operational(drive: DriveUnderTest) -> None:
    assert drive.nmt(RESET_NODE) == [BOOT_UP]
    assert read_device_type(drive) == [DEVICE_TYPE]
    assert state(with_heartbeat(drive)) == PRE_OPERATIONAL
    assert drive.sync() == []
    for kind in (1, 255):
        assert drive.write(0x1400, 2, kind, 1) == 0
        assert set_velocity_by_rpdo(drive) == "0"
    drive.device.emergency(0x2310, 0x02)
    assert drive.frames() == [(0x085, "1023030000000000")]


@case("NMT 3")
def test_operational(drive: DriveUnderTest) -> None:
    drive.nmt(START)
    assert read_device_type(drive) == [DEVICE_TYPE]
    assert state(with_heartbeat(drive)) == OPERATIONAL
    assert drive.sync() == [TPDO1, TPDO2]
    assert set_velocity_by_rpdo(drive) == "10000"
    drive.frames()
    drive.device.emergency(0x2310, 0x02)
    assert drive.frames() == [(0x085, "1023030000000000")]


@case("NMT 4")
@pytest.mark.parametrize("kind", [1, 255])
def test_stopped(drive: DriveUnderTest, kind: int) -> None:
    assert drive.write(0x1400, 2, kind, 1) == 0
    with_heartbeat(drive).nmt(STOP)
    assert read_device_type(drive) == []
    assert state(drive) == STOPPED
    assert drive.sync() == []
    assert set_velocity_by_rpdo(drive) == "0"
    drive.device.emergency(0x2310, 0x02)
    assert drive.frames() == []


@case("NMT 5")
@pytest.mark.parametrize("before", [START, STOP, ENTER_PRE_OPERATIONAL])
def test_reset_node_and_reset_communication(drive: DriveUnderTest, before: int) -> None:
    for reset in (RESET_NODE, RESET_COMMUNICATION):
        drive.nmt(before)
        assert drive.nmt(reset) == [BOOT_UP]
        assert state(with_heartbeat(drive)) == PRE_OPERATIONAL


@case("NMT 5")
def test_reset_communication_keeps_the_application(drive: DriveUnderTest) -> None:
    assert drive.write(0x605A, 0, 6, 2) == 0
    drive.nmt(RESET_COMMUNICATION)
    assert drive.read(0x605A) == 6
    drive.nmt(RESET_NODE)
    assert drive.read(0x605A) == 2


@case("NMT 6")
def test_enter_pre_operational(drive: DriveUnderTest) -> None:
    with_heartbeat(drive)
    for before in (START, STOP):
        drive.nmt(before)
        assert drive.nmt(ENTER_PRE_OPERATIONAL) == []
        assert state(drive) == PRE_OPERATIONAL


@case("NMT 7")
def test_start(drive: DriveUnderTest) -> None:
    with_heartbeat(drive)
    for before in (ENTER_PRE_OPERATIONAL, STOP):
        drive.nmt(before)
        assert drive.nmt(START) == []
        assert state(drive) == OPERATIONAL


@case("NMT 8")
def test_stop(drive: DriveUnderTest) -> None:
    with_heartbeat(drive)
    for before in (ENTER_PRE_OPERATIONAL, START):
        drive.nmt(before)
        assert drive.nmt(STOP) == []
        assert state(drive) == STOPPED


@case("NMT 8")
@pytest.mark.parametrize("data", ["0206", "02", "020500", "7705"])
def test_other_nmt_frames_change_nothing(drive: DriveUnderTest, data: str) -> None:
    with_heartbeat(drive).nmt(START)
    assert drive.send(0x000, data) == []
    assert state(drive) == OPERATIONAL
