"""EMCY cases of the conformance test: an RPDO that is too short makes the drive report 8210h."""

from __future__ import annotations

import pytest
from tests.canopen.device_under_test import DriveUnderTest

case = pytest.mark.case

#: Error code, error register (generic, communication), number of the RPDO.
TOO_SHORT = (0x085, "1082110100000000")


def send_empty_rpdo(drive: DriveUnderTest) -> list[tuple[int, str]]:
    drive.nmt(1)
    return drive.send(0x205)


@case("EMCY 1")
def test_identifier(drive: DriveUnderTest) -> None:
    assert drive.sdo("40 14 10 00 00000000") == "4314100085000000"


@case("EMCY 2")
def test_error_register_without_errors(drive: DriveUnderTest) -> None:
    assert drive.sdo("40 01 10 00 00000000") == "4f01100000000000"


@case("EMCY 3")
def test_error_history_without_errors(drive: DriveUnderTest) -> None:
    assert drive.sdo("40 03 10 00 00000000") == "4f03100000000000"
    assert drive.sdo("40 03 10 01 00000000") == "8003100124000008"


@case("EMCY 4")
def test_forced_message(drive: DriveUnderTest) -> None:
    assert send_empty_rpdo(drive) == [TOO_SHORT]


@case("EMCY 5")
def test_error_register_after_it(drive: DriveUnderTest) -> None:
    send_empty_rpdo(drive)
    assert drive.sdo("40 01 10 00 00000000") == "4f01100011000000"
    assert drive.send(0x205, bytes(6)) == [(0x085, "0000001082000000")]
    assert drive.sdo("40 01 10 00 00000000") == "4f01100000000000"


@case("EMCY 6")
def test_error_history_after_it(drive: DriveUnderTest) -> None:
    send_empty_rpdo(drive)
    assert drive.sdo("40 03 10 00 00000000") == "4f03100001000000"
    assert drive.sdo("40 03 10 01 00000000") == "4303100110820100"  # code, first bytes of the manufacturer's field
    assert drive.sdo("40 03 10 02 00000000") == "8003100224000008"
