"""SYNC cases of the conformance test: the drive is a consumer."""

from __future__ import annotations

import pytest
from tests.canopen.device_under_test import DriveUnderTest

case = pytest.mark.case

TPDO1 = (0x185, "5002000000000000")
TPDO2 = (0x285, "00000000")
SAVE = "23 10 10 01 73617665"


@case("SYNC 1")
def test_default_identifier(drive: DriveUnderTest) -> None:
    assert drive.sdo("40 05 10 00 00000000") == "4305100080000000"


@case("SYNC 3")
def test_every_tenth_sync_brings_a_pdo(drive: DriveUnderTest) -> None:
    assert drive.sdo("23 00 18 01 850100c0") == "6000180100000000"
    assert drive.sdo("2f 00 18 02 0a000000") == "6000180200000000"
    assert drive.sdo("23 00 18 01 85010040") == "6000180100000000"
    drive.nmt(1)
    sent = [drive.sync() for _ in range(100)]
    assert [number for number, frames in enumerate(sent, 1) if TPDO1 in frames] == list(range(10, 101, 10))


@case("SYNC 4")
def test_consumer_without_period(drive: DriveUnderTest) -> None:
    assert drive.sdo("23 05 10 00 80000000") == "6005100000000000"
    assert drive.sdo("23 06 10 00 00000000") == "6006100000000000"
    drive.nmt(1)
    assert drive.sync() == [TPDO1, TPDO2]


@case("SYNC 5")
def test_invalid_counter(drive: DriveUnderTest) -> None:
    assert drive.sdo("2f 19 10 00 01000000") == "8019100030000906"
    assert drive.sdo("2f 19 10 00 f1000000") == "8019100031000906"


@case("SYNC 6")
def test_without_counter_sync_carries_no_data(drive: DriveUnderTest) -> None:
    assert drive.sdo("2f 19 10 00 05000000") == "6019100000000000"
    assert drive.sdo("2f 19 10 00 00000000") == "6019100000000000"
    drive.nmt(1)
    assert drive.sync() == [TPDO1, TPDO2]
    assert drive.sync(b"\x01") == [(0x085, "4082110100000000")]


@case("SYNC 8")
def test_counter_survives_a_reset_when_stored(drive: DriveUnderTest) -> None:
    assert drive.sdo("2f 19 10 00 05000000") == "6019100000000000"
    assert drive.sdo(SAVE) == "6010100100000000"
    assert drive.nmt(129) == [(0x705, "00")]
    assert drive.sdo("40 19 10 00 00000000") == "4f19100005000000"
    drive.nmt(1)
    assert drive.sync(b"\x01") == [TPDO1, TPDO2]
    assert drive.sync() == [(0x085, "4082110000000000")]


@case("SYNC 9")
def test_counter_stays_while_a_period_is_set(drive: DriveUnderTest) -> None:
    assert drive.sdo("23 06 10 00 e8030000") == "6006100000000000"
    assert drive.sdo("2f 19 10 00 05000000") == "8019100022000008"


@case("SYNC 10")
def test_values_are_stored(drive: DriveUnderTest) -> None:
    assert drive.sdo("23 05 10 00 90000000") == "6005100000000000"
    assert drive.sdo("2f 19 10 00 05000000") == "6019100000000000"
    assert drive.sdo("23 06 10 00 e8030000") == "6006100000000000"
    assert drive.sdo(SAVE) == "6010100100000000"
    drive.nmt(129)
    assert drive.sdo("40 05 10 00 00000000") == "4305100090000000"
    assert drive.sdo("40 06 10 00 00000000") == "43061000e8030000"
    assert drive.sdo("40 19 10 00 00000000") == "4f19100005000000"
    assert drive.device.sync_cob_id == 0x090
