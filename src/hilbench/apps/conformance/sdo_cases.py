"""Actions of SDO cases (CiA 301, 7.2.4): expedited, segmented and block transfers with the default server."""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Mapping
from typing import Final, Literal

from hilbench.apps.conformance.actions import ABORT_CODES, AbortCode, Key
from hilbench.apps.conformance.dut import DeviceUnderTest, aborted, multiplexed
from hilbench.apps.conformance.record import NotApplicableError, some
from hilbench.apps.conformance.steps import read_if_there
from hilbench.canopen.identifiers import SDO_REQUEST
from hilbench.canopen.object_store import INVALID_VALUE, NO_OBJECT, TOGGLE, UNKNOWN_COMMAND, WRITE_ONLY
from hilbench.canopen.sdo_client import Refusal

_STRINGS: Final = (0x1008, 0x1009, 0x100A)
_WITH_CRC: Final = 0x04


def read_write_only(dut: DeviceUnderTest) -> None:
    """Refused, in all that the file calls write-only."""
    unreadable = [entry for entry in dut.eds.entries() if not entry.readable]
    for entry in some(unreadable, "no object is write-only in the EDS file"):
        request = multiplexed(0x40, entry.index, entry.sub).hex()
        dut.ask(f"read {entry}", request, aborted(entry.index, entry.sub, WRITE_ONLY))


def read_no_object(dut: DeviceUnderTest) -> None:
    """An object that is not there."""
    absent = [index for index in (0x1004, *range(0x1030, 0x1200)) if index not in dut.eds.od.indices]
    index = absent[0]
    dut.ask(f"read {index:04X}h:0", multiplexed(0x40, index, 0).hex(), aborted(index, 0, NO_OBJECT))


def wrong_length(dut: DeviceUnderTest, widths: list[int], length: int, code: AbortCode) -> None:
    """Write `length` bytes into objects of other lengths."""
    areas = (0x1003, 0x1005, 0x1006, 0x1015, 0x1017, 0x1019)
    found = [
        dut.eds.entry(index)
        for index in areas
        if dut.eds.can_write(index) and dut.eds.entry(index).kind.width in widths
    ]
    for entry in some(found, "no object of 1000h to 1FFFh of such a length can be written by the EDS file"):
        dut.refuses(
            f"{length} bytes to {entry}", entry.index, entry.sub, bytes(length), code, ABORT_CODES["WRONG_LENGTH"]
        )


def beyond_limit(dut: DeviceUnderTest, limit: Literal["min", "max"], code: AbortCode, known: Mapping[Key, int]) -> None:
    """Refused are values that the standard forbids, and the one beyond the first limit in the file."""
    known = {key: value for key, value in known.items() if dut.eds.can_write(*key)}
    for (index, sub), value in known.items():
        dut.refuses(f"{value} to {index:04X}h:{sub}", index, sub, dut.data_of(index, sub, value), code, INVALID_VALUE)
    found = ((e, e.beyond(limit)) for e in dut.eds.entries(0x1000) if e.writable and e.kind.is_integer)
    entry, beyond = next((each for each in found if each[1] is not None), (None, None))
    if entry is not None and beyond is not None:
        data = dut.data_of(*entry.key, beyond)
        dut.refuses(f"{beyond} to {entry}", *entry.key, data, code, INVALID_VALUE)
    elif not known:
        raise NotApplicableError("the EDS file has no limit that could be passed")


def _long_text(dut: DeviceUnderTest) -> tuple[int, bytes]:
    """An object of more than four bytes, and its data."""
    for index in (*_STRINGS, *sorted(dut.eds.od.indices)):
        entry = dut.eds.entry(index) if dut.eds.has(index) else None
        if (
            entry is not None
            and index >= 0x1000
            and entry.readable
            and (entry.kind.width is None or entry.kind.width > 4)
        ):
            data = dut.peek(index, 0)
            if isinstance(data, bytes) and len(data) > 4:
                return index, data
    raise NotApplicableError("no object has more than four bytes")


def segmented_upload(dut: DeviceUnderTest) -> None:
    """The size is announced, the toggle bit alternates, the last segment is marked."""
    index, data = _long_text(dut)
    _segmented_upload(dut, index, data)


def _segmented_upload(dut: DeviceUnderTest, index: int, data: bytes) -> None:
    mux = multiplexed(0, index, 0)[1:4].hex()
    size = len(data).to_bytes(4, "little").hex()
    dut.ask(f"read {index:04X}h:0", f"40 {mux} 00000000", f"41 {mux} {size}", f"40 {mux} ????????")
    toggle = 0x00
    for at in range(0, len(data), 7):
        part = data[at : at + 7]
        last = at + 7 >= len(data)
        head = toggle | (7 - len(part)) << 1 | int(last)
        expected = f"{head:02x} {part.hex()}{'??' * (7 - len(part))}"
        dut.ask(f"segment {at // 7 + 1}", f"{0x60 | toggle:02x} 00000000000000", expected)
        toggle ^= 0x10


def wrong_toggle_bit(dut: DeviceUnderTest) -> None:
    """The first segment has toggle bit 0, the second 1."""
    index, data = _long_text(dut)
    mux = multiplexed(0, index, 0)[1:4].hex()
    refused = aborted(index, 0, TOGGLE)
    dut.ask("begin", f"40 {mux} 00000000", f"4? {mux} ????????")
    dut.ask("first segment with toggle bit 1", "70 00000000000000", refused)
    if len(data) > 7:
        dut.ask("begin", f"40 {mux} 00000000", f"4? {mux} ????????")
        dut.ask("first segment", "60 00000000000000", "0? ??????????????")
        dut.ask("second segment with toggle bit 0", "60 00000000000000", refused)


def all_segmented(dut: DeviceUnderTest) -> None:
    """Every text of the communication profile, and nothing after the last segment."""
    texts = [(i, d) for i in _STRINGS if dut.eds.has(i) and isinstance(d := dut.peek(i, 0), bytes) and len(d) > 4]
    texts = texts or [_long_text(dut)]
    for index, data in texts:
        _segmented_upload(dut, index, data)
        toggle = 0x10 if (len(data) + 6) // 7 % 2 else 0x00
        dut.ask("one more segment", f"{0x60 | toggle:02x} 00000000000000", "80??????01000405")


# -- block transfer --------------------------------------------------------------------------------------------


def _begin_block(dut: DeviceUnderTest, request: bytes) -> bytes:
    """The answer to the beginning. Raises NotApplicableError when the server has no block transfer."""
    answer = dut.exchange(request) or b""
    if answer[:1] == b"\x80" and answer[4:] == UNKNOWN_COMMAND.to_bytes(4, "little"):
        raise NotApplicableError(f"no block transfer: {Refusal(UNKNOWN_COMMAND)}")
    return answer


def begin_block_upload(dut: DeviceUnderTest, key: Key, crc: bool = False) -> bytes:
    """The answer to the beginning."""
    answer = _begin_block(dut, multiplexed(0xA0 | crc * _WITH_CRC, *key, bytes((20, 0, 0, 0))))
    mux = multiplexed(0, *key)[1:4].hex()
    ok = answer.hex().startswith(("c2" + mux, "c6" + mux, "c0" + mux, "c4" + mux))
    dut.must(dut.check("begin block upload", f"c? {mux} and the size", answer.hex(" ") or "nothing", ok))
    return answer


def block_upload(dut: DeviceUnderTest, crc: bool, key: Key | None = None) -> None:
    """An object of four bytes, by default a text, with or without CRC."""
    if key is None:
        index, data = _long_text(dut)
        key = index, 0
    else:
        data = dut.value(*key).to_bytes(4, "little")
    answer = begin_block_upload(dut, key, crc)
    parts = [data[at : at + 7] for at in range(0, len(data), 7)]
    dut.send(SDO_REQUEST + dut.node_id, bytes((0xA3, *bytes(7))))
    found = dut.segments(len(parts))
    for number, (part, seen) in enumerate(zip(parts, [*found, *[b""] * len(parts)], strict=False), 1):
        last = 0x80 if number == len(parts) else 0
        wanted = bytes((number | last,)) + part
        dut.check(f"segment {number}", wanted.hex(" "), seen.hex(" ") or "nothing", seen[: len(wanted)] == wanted)
    unused = 7 - len(parts[-1])
    checked = crc and answer[0] & _WITH_CRC
    digits = crc_hqx(data, 0).to_bytes(2, "little").hex() if checked else "????"
    dut.ask("end of the block", f"a2 {len(parts):02x} 14 0000000000", f"{0xC1 | unused << 2:02x} {digits} ??????????")
    dut.send(SDO_REQUEST + dut.node_id, bytes((0xA1, *bytes(7))))
    dut.ask("the server is ready again", "40 00 10 00 00000000", "43 00 10 00 ????????")


def block_download(dut: DeviceUnderTest, key: Key, crc: bool) -> None:
    """Two bytes in a block."""
    dut.touched.add(key)
    mux = multiplexed(0, *key)[1:4].hex()
    answer = _begin_block(dut, multiplexed(0xC2 | crc * _WITH_CRC, *key, b"\x02"))
    ok = answer[:1] in (b"\xa0", b"\xa4") and answer[1:4].hex() == mux
    dut.must(dut.check("begin block download", f"a? {mux} and the block size", answer.hex(" ") or "nothing", ok))
    dut.ask("the only segment", "81 e803 0000000000", "a2 01 ????????????")
    digits = crc_hqx(bytes.fromhex("e803"), 0).to_bytes(2, "little").hex() if crc and answer[0] & _WITH_CRC else "0000"
    dut.ask("the end", f"d5 {digits} 0000000000", "a1 ??????????????")
    dut.reads("read it back", *key, 1000)


# -- servers and clients ---------------------------------------------------------------------------------------


def further_servers(dut: DeviceUnderTest) -> None:
    """SDO servers of the file are there, and no others."""
    read_if_there(dut, "43", [(index, 1) for index in range(0x1201, 0x1280)])
