"""OD cases of the conformance test: every object of the EDS file behaves as the file says."""

from __future__ import annotations

import re
import struct
from configparser import ConfigParser
from dataclasses import dataclass

import pytest
from tests.canopen.device_under_test import NODE, SERVO_EDS, DeviceUnderTest, DriveUnderTest

case = pytest.mark.case

READ_ONLY, NO_SUB_INDEX, TOO_HIGH, TOO_LOW, NO_DATA = 0x06010002, 0x06090011, 0x06090031, 0x06090032, 0x08000024
STORE_AND_RESTORE = (0x1010, 0x1011)  #: they take a signature only: cases of their own
ERROR_HISTORY = 0x1003  #: its entries have no data before the first error
REFUSE_WRITE_ON_DOWNLOAD, REFUSE_READ_ON_SCAN = 0x1, 0x2  #: ObjFlags (CiA 306)

CODES = {2: "b", 3: "h", 4: "i", 5: "B", 6: "H", 7: "I", 8: "I"}
REAL32, STRING = 8, 9


@dataclass(frozen=True)
class Entry:
    """One value as the EDS file describes it; limits and default as SDO data, None where the file has none."""

    index: int
    sub: int
    access: str
    flags: int
    kind: int
    default: bytes | None
    low: str | None
    high: str | None

    @property
    def is_parameter_of_the_history(self) -> bool:
        return self.index == ERROR_HISTORY and self.sub > 0

    @property
    def size(self) -> int:
        """Bytes of its data (of a string: of its default)."""
        return len(self.default or b"") if self.kind == STRING else struct.calcsize(CODES[self.kind])


def encoded(kind: int, text: str) -> bytes:
    if kind == STRING:
        return text.encode("ascii")
    number = sum(NODE if term == "$NODEID" else int(term, 0) for term in text.split("+"))
    return struct.pack("<" + CODES[kind], number)  # REAL32: the digits of IEEE 754


def entries(first: int, last: int) -> list[Entry]:
    """Those of an area, a PDO's parameters in the order of a configuration: number of mapped objects last."""
    parser = ConfigParser(interpolation=None)
    parser.read(SERVO_EDS, encoding="ascii")
    found: list[Entry] = []
    for name, section in parser.items():
        match = re.fullmatch(r"([0-9A-F]{4})(?:sub([0-9A-F]+))?", name)
        if match is None or "DataType" not in section or not first <= int(match[1], 16) <= last:
            continue
        kind = int(section["DataType"], 0)
        found.append(
            Entry(
                index=int(match[1], 16),
                sub=int(match[2] or "0", 16),
                access=section["AccessType"],
                flags=int(section.get("ObjFlags", "0"), 0),
                kind=kind,
                default=encoded(kind, section["DefaultValue"]) if "DefaultValue" in section else None,
                low=section.get("LowLimit"),
                high=section.get("HighLimit"),
            )
        )
    assert found
    return sorted(found, key=lambda entry: (entry.index, entry.sub == 0, entry.sub))


COMMUNICATION, DEVICE = (0x1000, 0x1FFF), (0x2000, 0x9FFF)


def open_pdos(drive: DriveUnderTest) -> None:
    """All PDOs invalid and nothing mapped, so that every parameter of theirs may be written."""
    for base, cob_id in ((0x1400, 0x80000205), (0x1800, 0xC0000185)):
        for number in range(4):
            assert drive.write(base + number, 1, cob_id + 0x100 * number, 4) == 0
            assert drive.write(base + 0x200 + number, 0, 0, 1) == 0


def write_back(drive: DriveUnderTest, entry: Entry, data: bytes) -> int:
    return drive.write(entry.index, entry.sub, int.from_bytes(data, "little"), len(data))


def access(drive: DriveUnderTest, entry: Entry) -> None:
    """Reading gives data of the object's length, and what is writable takes them back."""
    data = drive.upload(entry.index, entry.sub)
    if entry.is_parameter_of_the_history:
        assert data == NO_DATA
        return
    assert isinstance(data, bytes), f"{entry} is refused with {data:08X}h"
    assert entry.kind == STRING or len(data) == entry.size
    if entry.access in ("rw", "rwr", "rww") and entry.index not in STORE_AND_RESTORE:
        assert write_back(drive, entry, data) == 0, entry
        assert drive.upload(entry.index, entry.sub) == data


@case("OD 1")
def test_access_to_the_communication_profile(drive: DriveUnderTest) -> None:
    found = entries(*COMMUNICATION)
    assert {entry.access for entry in found} == {"ro", "rw", "const"}
    open_pdos(drive)
    for entry in found:
        access(drive, entry)


@case("OD 2")
def test_defaults_of_the_communication_profile(drive: DriveUnderTest) -> None:
    for entry in entries(*COMMUNICATION):
        if not entry.is_parameter_of_the_history:
            assert drive.upload(entry.index, entry.sub) == entry.default, entry


@case("OD 3")
def test_read_only_objects_are_not_written(drive: DriveUnderTest) -> None:
    found = [entry for entry in entries(0x1000, 0x9FFF) if entry.access in ("ro", "const")]
    for entry in found:
        if entry.kind != STRING:
            assert write_back(drive, entry, bytes(entry.size)) == READ_ONLY, entry
        else:  # refused at once, not after the last segment
            head = bytes((0x21, entry.index & 0xFF, entry.index >> 8, entry.sub))
            answer = drive.sdo((head + entry.size.to_bytes(4, "little")).hex())
            assert answer == "80" + head[1:].hex() + "02000106"


@case("OD 4")
def test_write_only_objects_are_not_read(dut: DeviceUnderTest) -> None:
    assert dut.sdo("2f 01 20 00 07000000") == "6001200000000000"
    assert dut.sdo("40 01 20 00 00000000") == "8001200001000106"


@case("OD 5")
def test_no_object_has_the_sub_index_255(drive: DriveUnderTest) -> None:
    for index in sorted({entry.index for entry in entries(0x1000, 0x9FFF)}):
        assert drive.upload(index, 0xFF) == NO_SUB_INDEX


@case("OD 6")
def test_limits(drive: DriveUnderTest) -> None:
    limits = [
        (entry, int(text, 0) + step, abort)
        for entry in entries(0x1000, 0x9FFF)
        if entry.access in ("rw", "rwr", "rww")
        for text, step, abort in ((entry.low, -1, TOO_LOW), (entry.high, +1, TOO_HIGH))
        if text is not None
    ]
    assert {abort for _, _, abort in limits} == {TOO_LOW, TOO_HIGH}
    for entry, value, abort in limits:
        assert drive.write(entry.index, entry.sub, value, entry.size) == abort, entry


@case("OD 7")
def test_access_to_the_device_profile(drive: DriveUnderTest) -> None:
    found = entries(*DEVICE)
    assert {entry.access for entry in found} == {"ro", "rw", "rww", "const"}
    for entry in found:
        access(drive, entry)


@case("OD 8")
def test_defaults_of_the_device_profile(drive: DriveUnderTest) -> None:
    found = entries(*DEVICE)
    assert {entry.kind for entry in found if entry.default is None} == {REAL32}  # tools/make_eds.py says why
    for entry in found:
        if entry.default is not None and not entry.flags & REFUSE_READ_ON_SCAN:
            assert drive.upload(entry.index, entry.sub) == entry.default, entry


@case("OD 9")
def test_values_are_read_and_written_back(drive: DriveUnderTest) -> None:
    found = [entry for entry in entries(*DEVICE) if entry.access in ("rw", "rwr", "rww")]
    for entry in found:
        if not entry.flags & REFUSE_WRITE_ON_DOWNLOAD:
            data = drive.upload(entry.index, entry.sub)
            assert isinstance(data, bytes)
            assert write_back(drive, entry, data) == 0, entry
