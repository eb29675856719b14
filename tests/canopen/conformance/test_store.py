"""Store, restore and identifier cases of the conformance test."""

from __future__ import annotations

import pytest
from tests.canopen.device_under_test import DriveUnderTest

case = pytest.mark.case

ALL, COMMUNICATION = 1, 2
SAVE, LOAD, WRONG = "73617665", "6c6f6164", "6e6f7277"
RESET_NODE = 129
#: Object, its length and a value that is not its default.
CHANGES = {0x1005: (4, 0x090), 0x1006: (4, 5000), 0x1015: (2, 1000), 0x1017: (2, 20_000)}
DEFAULTS = {0x1005: 0x080, 0x1006: 0, 0x1015: 0, 0x1017: 0}


def change(drive: DriveUnderTest) -> None:
    for index, (size, value) in CHANGES.items():
        assert drive.write(index, 0, value, size) == 0


def values(drive: DriveUnderTest) -> dict[int, int]:
    return {index: drive.read(index) for index in CHANGES}


def changed() -> dict[int, int]:
    return {index: value for index, (_, value) in CHANGES.items()}


def command(drive: DriveUnderTest, index: int, part: int, signature: str) -> str:
    return drive.sdo(f"23 {index & 0xFF:02x} 10 {part:02x} {signature}")


def save_with_wrong_signature(drive: DriveUnderTest, part: int) -> None:
    change(drive)
    assert command(drive, 0x1010, part, WRONG) == f"801010{part:02x}20000008"
    drive.nmt(RESET_NODE)
    assert values(drive) == DEFAULTS


def save(drive: DriveUnderTest, part: int) -> None:
    assert drive.sdo(f"40 10 10 {part:02x} 00000000") == f"431010{part:02x}01000000"  # on command
    change(drive)
    assert command(drive, 0x1010, part, SAVE) == f"601010{part:02x}00000000"
    drive.nmt(RESET_NODE)
    assert values(drive) == changed()


def restore_with_wrong_signature(drive: DriveUnderTest, part: int) -> None:
    save(drive, part)
    assert command(drive, 0x1011, part, WRONG) == f"801110{part:02x}20000008"
    drive.nmt(RESET_NODE)
    assert values(drive) == changed()


def restore(drive: DriveUnderTest, part: int) -> None:
    assert drive.sdo(f"40 11 10 {part:02x} 00000000") == f"431110{part:02x}01000000"
    save(drive, part)
    assert command(drive, 0x1011, part, LOAD) == f"601110{part:02x}00000000"
    assert values(drive) == changed()  # the defaults act after the reset
    drive.nmt(RESET_NODE)
    assert values(drive) == DEFAULTS


@case("Store and restore 1")
def test_save_all_with_wrong_signature(drive: DriveUnderTest) -> None:
    save_with_wrong_signature(drive, ALL)


@case("Store and restore 2")
def test_save_all(drive: DriveUnderTest) -> None:
    assert drive.write(0x605A, 0, 6, 2) == 0
    save(drive, ALL)
    assert drive.read(0x605A) == 6


@case("Store and restore 3")
def test_restore_all_with_wrong_signature(drive: DriveUnderTest) -> None:
    restore_with_wrong_signature(drive, ALL)


@case("Store and restore 4")
def test_restore_all(drive: DriveUnderTest) -> None:
    assert drive.write(0x605A, 0, 6, 2) == 0
    restore(drive, ALL)
    assert drive.read(0x605A) == 2


@case("Store and restore 5")
def test_save_communication_with_wrong_signature(drive: DriveUnderTest) -> None:
    save_with_wrong_signature(drive, COMMUNICATION)


@case("Store and restore 6")
def test_save_communication(drive: DriveUnderTest) -> None:
    assert drive.write(0x605A, 0, 6, 2) == 0
    save(drive, COMMUNICATION)
    assert drive.read(0x605A) == 2  # the quick stop option code is none of the communication's parameters


@case("Store and restore 7")
def test_restore_communication_with_wrong_signature(drive: DriveUnderTest) -> None:
    restore_with_wrong_signature(drive, COMMUNICATION)


@case("Store and restore 8")
def test_restore_communication(drive: DriveUnderTest) -> None:
    assert drive.write(0x605A, 0, 6, 2) == 0
    assert command(drive, 0x1010, ALL, SAVE) == "6010100100000000"
    restore(drive, COMMUNICATION)
    assert drive.read(0x605A) == 6


RESTRICTED = [0x000, *range(0x001, 0x080), *range(0x101, 0x181), *range(0x581, 0x600), *range(0x601, 0x680)]
RESTRICTED += [*range(0x6E0, 0x700), *range(0x701, 0x780)]  # CiA 301, table of restricted CAN-IDs


@case("Store and restore 10")
@pytest.mark.parametrize(("index", "sub"), [(0x1005, 0), (0x1014, 0), (0x1400, 1), (0x1800, 1)])
def test_restricted_identifiers(drive: DriveUnderTest, index: int, sub: int) -> None:
    in_use = drive.read(index, sub)
    if index != 0x1005:  # SYNC has no bit that makes it invalid
        assert drive.write(index, sub, 0x80000000 | in_use, 4) == 0
    for cob_id in RESTRICTED:
        assert drive.write(index, sub, cob_id, 4) == 0x06090030
    assert drive.write(index, sub, in_use, 4) == 0
