"""SDO cases (CiA 301, 7.2.4): expedited, segmented and block transfers with the default server."""

from __future__ import annotations

from binascii import crc_hqx
from collections.abc import Callable, Mapping
from typing import Final

from hilbench.apps.conformance.dut import DeviceUnderTest, aborted, multiplexed
from hilbench.apps.conformance.record import NotApplicableError
from hilbench.canopen.identifiers import SDO_ANSWER, SDO_REQUEST, NmtCommand
from hilbench.canopen.object_store import (
    BLOCK_SIZE,
    GENERAL_ERROR,
    INVALID_VALUE,
    NO_OBJECT,
    NO_SUB_INDEX,
    READ_ONLY,
    SEQUENCE_NUMBER,
    TOGGLE,
    TOO_LONG,
    TOO_SHORT,
    UNKNOWN_COMMAND,
    VALUE_TOO_HIGH,
    VALUE_TOO_LOW,
    WRITE_ONLY,
)
from hilbench.canopen.sdo_client import Refusal

#: Length does not match, in either direction (CiA 301, table 22).
WRONG_LENGTH: Final = 0x06070010
_STRINGS: Final = (0x1008, 0x1009, 0x100A)
#: Objects whose value may be another one for a moment, and one that is none by default.
_PARAMETERS: Final = {(0x1017, 0): 1000, (0x1015, 0): 10, (0x1016, 1): 0x7D0064}
_NO_CRC, _WITH_CRC = 0x00, 0x04


def read_device_type(dut: DeviceUnderTest) -> None:
    """An object of four bytes comes in one frame."""
    default = dut.eds.entry(0x1000).default
    value = "????????" if default is None else default.hex()
    dut.ask("read 1000h:0", "40 00 10 00 00000000", f"43 00 10 00 {value}")


def read_and_write(dut: DeviceUnderTest) -> None:
    """Parameters take another value, and give it back."""
    there = {key: value for key, value in _PARAMETERS.items() if dut.eds.can_write(*key)}
    if not there:
        raise NotApplicableError("neither 1015h, 1016h nor 1017h can be written by the EDS file")
    for (index, sub), value in there.items():
        dut.write(index, sub, value)
        dut.reads(f"read {index:04X}h:{sub} back", index, sub, value)


def write_device_type(dut: DeviceUnderTest) -> None:
    """It is read-only."""
    data = dut.value(0x1000).to_bytes(4, "little")
    dut.refuses("write 1000h:0", 0x1000, 0, data, READ_ONLY)


def read_write_only(dut: DeviceUnderTest) -> None:
    """Refused, in all that the file calls write-only."""
    found = [entry for entry in dut.eds.entries() if not entry.readable]
    if not found:
        raise NotApplicableError("no object is write-only in the EDS file")
    for entry in found:
        request = multiplexed(0x40, entry.index, entry.sub).hex()
        dut.ask(f"read {entry}", request, aborted(entry.index, entry.sub, WRITE_ONLY))


def read_no_sub_index(dut: DeviceUnderTest) -> None:
    """An object that is there lacks this sub-index."""
    dut.ask("read 1000h:1", "40 00 10 01 00000000", aborted(0x1000, 1, NO_SUB_INDEX))


def read_no_object(dut: DeviceUnderTest) -> None:
    """An object that is not there."""
    absent = [index for index in (0x1004, *range(0x1030, 0x1200)) if index not in dut.eds.od.indices]
    index = absent[0]
    dut.ask(f"read {index:04X}h:0", multiplexed(0x40, index, 0).hex(), aborted(index, 0, NO_OBJECT))


def unknown_command(dut: DeviceUnderTest) -> None:
    """The upper three bits of the request mean nothing."""
    dut.ask("command specifier 7", "e0 00 10 00 00000000", aborted(0x1000, 0, UNKNOWN_COMMAND), "80??????01000405")


def write_too_long(dut: DeviceUnderTest) -> None:
    """Four bytes into objects of one and two."""
    _wrong_length(dut, lambda width: width in (1, 2), 4, TOO_LONG)


def write_too_short(dut: DeviceUnderTest) -> None:
    """One byte into objects of two and four."""
    _wrong_length(dut, lambda width: width in (2, 4), 1, TOO_SHORT)


def _wrong_length(dut: DeviceUnderTest, fits: Callable[[int], bool], length: int, code: int) -> None:
    areas = (0x1003, 0x1005, 0x1006, 0x1015, 0x1017, 0x1019)
    found = [
        dut.eds.entry(index) for index in areas if dut.eds.can_write(index) and fits(dut.eds.entry(index).width or 0)
    ]
    if not found:
        raise NotApplicableError("no object of 1000h to 1FFFh of such a length can be written by the EDS file")
    for entry in found:
        dut.refuses(f"{length} bytes to {entry}", entry.index, entry.sub, bytes(length), code, WRONG_LENGTH)


def write_too_high(dut: DeviceUnderTest) -> None:
    """1003h:0 takes 0 alone, 1019h up to 240, others the maximum in the file."""
    known = {0x1003: 0xFF, 0x1019: 0xF1}
    _beyond(dut, {i: v for i, v in known.items() if dut.eds.can_write(i)}, "max", 1, VALUE_TOO_HIGH)


def write_too_low(dut: DeviceUnderTest) -> None:
    """Values below the minimum in the file are refused."""
    _beyond(dut, {}, "min", -1, VALUE_TOO_LOW)


def _beyond(dut: DeviceUnderTest, known: Mapping[int, int], limit: str, step: int, code: int) -> None:
    for index, value in known.items():
        dut.refuses(f"{value} to {index:04X}h:0", index, 0, dut.data_of(index, 0, value), code, INVALID_VALUE)
    entry = next(
        (
            e
            for e in dut.eds.entries(0x1000)
            if e.writable and e.is_integer and _fits(e.width, getattr(e.variable, limit), step)
        ),
        None,
    )
    if entry is not None:
        value = int(getattr(entry.variable, limit)) + step
        data = dut.data_of(entry.index, entry.sub, value)
        dut.refuses(f"{value} to {entry}", entry.index, entry.sub, data, code, INVALID_VALUE)
    elif not known:
        raise NotApplicableError("the EDS file has no limit that could be passed")


def _fits(width: int | None, limit: int | None, step: int) -> bool:
    """True if the value beyond a limit is one of the type (as unsigned: a bit pattern is sent)."""
    if width is None or limit is None:
        return False
    low = -(1 << 8 * width - 1) if limit < 0 else 0
    return low <= limit + step < 1 << (8 * width - (1 if limit < 0 else 0))


def default_server(dut: DeviceUnderTest) -> None:
    """The predefined identifiers."""
    dut.needs((0x1200, 1), (0x1200, 2))
    for sub, cob_id in ((1, SDO_REQUEST), (2, SDO_ANSWER)):
        value = (cob_id + dut.node_id).to_bytes(4, "little").hex()
        dut.ask(f"read 1200h:{sub}", f"40 00 12 {sub:02x} 00000000", f"43 00 12 {sub:02x} {value}")


def four_bytes_need_no_segments(dut: DeviceUnderTest) -> None:
    """After an expedited upload there is nothing left to ask for."""
    dut.ask("read 1000h:0", "40 00 10 00 00000000", "43 00 10 00 ????????")
    dut.ask("ask for a segment", "60 00000000000000", "80??????01000405")


def segmented_download(dut: DeviceUnderTest, index: int) -> None:
    """Two bytes in a segment."""
    dut.needs_to_write((index, 0))
    dut.touched.add((index, 0))
    mux = multiplexed(0, index, 0)[1:4].hex()
    dut.ask("begin", f"21 {mux} 02000000", f"60 {mux} ????????")
    dut.ask("the segment", "0b e803 0000000000", "20 ??????????????")
    dut.reads("read it back", index, 0, 1000)


def _long_text(dut: DeviceUnderTest) -> tuple[int, bytes]:
    """An object of more than four bytes, and its data."""
    for index in (*_STRINGS, *sorted(dut.eds.od.indices)):
        entry = dut.eds.entry(index) if dut.eds.has(index) else None
        if entry is not None and index >= 0x1000 and entry.readable and (entry.width is None or entry.width > 4):
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


def _begin_block_upload(dut: DeviceUnderTest, index: int, crc: int) -> bytes:
    """The answer to the beginning. Raises NotApplicableError when the server has no block transfer."""
    request = multiplexed(0xA0 | crc, index, 0, bytes((20, 0, 0, 0)))
    answer = dut.exchange(request) or b""
    if answer[:1] == b"\x80" and answer[4:] == UNKNOWN_COMMAND.to_bytes(4, "little"):
        raise NotApplicableError(f"no block transfer: {Refusal(UNKNOWN_COMMAND)}")
    mux = multiplexed(0, index, 0)[1:4].hex()
    ok = answer.hex().startswith(("c2" + mux, "c6" + mux, "c0" + mux, "c4" + mux))
    dut.must(dut.check("begin block upload", f"c? {mux} and the size", answer.hex(" ") or "nothing", ok))
    return answer


def _block_upload(dut: DeviceUnderTest, index: int, data: bytes, crc: int) -> None:
    answer = _begin_block_upload(dut, index, crc)
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


def block_upload_of_four_bytes(dut: DeviceUnderTest) -> None:
    """An object of four bytes, without CRC."""
    _block_upload(dut, 0x1000, dut.value(0x1000).to_bytes(4, "little"), _NO_CRC)


def block_upload(dut: DeviceUnderTest) -> None:
    """A text, without CRC."""
    _block_upload(dut, *_long_text(dut), _NO_CRC)


def block_upload_with_crc(dut: DeviceUnderTest) -> None:
    """A text, with CRC."""
    _block_upload(dut, *_long_text(dut), _WITH_CRC)


def block_download(dut: DeviceUnderTest, index: int, crc: int) -> None:
    """Two bytes in a block."""
    dut.needs_to_write((index, 0))
    dut.touched.add((index, 0))
    mux = multiplexed(0, index, 0)[1:4].hex()
    answer = dut.exchange(bytes.fromhex(f"{0xC2 | crc:02x}{mux}02000000")) or b""
    if answer[:1] == b"\x80" and answer[4:] == UNKNOWN_COMMAND.to_bytes(4, "little"):
        raise NotApplicableError(f"no block transfer: {Refusal(UNKNOWN_COMMAND)}")
    ok = answer[:1] in (b"\xa0", b"\xa4") and answer[1:4].hex() == mux
    dut.must(dut.check("begin block download", f"a? {mux} and the block size", answer.hex(" ") or "nothing", ok))
    dut.ask("the only segment", "81 e803 0000000000", "a2 01 ????????????")
    digits = crc_hqx(bytes.fromhex("e803"), 0).to_bytes(2, "little").hex() if crc and answer[0] & _WITH_CRC else "0000"
    dut.ask("the end", f"d5 {digits} 0000000000", "a1 ??????????????")
    dut.reads("read it back", index, 0, 1000)


def wrong_block_size(dut: DeviceUnderTest) -> None:
    """A block has 1 to 127 segments."""
    _begin_block_upload(dut, 0x1000, _NO_CRC)
    dut.send(SDO_REQUEST + dut.node_id, multiplexed(0x80, 0x1000, 0, b"\x00\x00\x00\x08"))  # the client gives up
    for size in (0x80, 0x00, 0xFF):
        dut.ask(f"block size {size}", f"a0 00 10 00 {size:02x}000000", aborted(0x1000, 0, BLOCK_SIZE))


def wrong_sequence_number(dut: DeviceUnderTest) -> None:
    """One segment was sent, 128 are acknowledged."""
    _begin_block_upload(dut, 0x1000, _NO_CRC)
    dut.send(SDO_REQUEST + dut.node_id, bytes((0xA3, *bytes(7))))
    dut.segments(1)
    codes = (SEQUENCE_NUMBER, UNKNOWN_COMMAND, GENERAL_ERROR)
    dut.ask("128 acknowledged", "a2 80 14 0000000000", *(aborted(0x1000, 0, code) for code in codes))


# -- servers and clients ---------------------------------------------------------------------------------------


def further_servers(dut: DeviceUnderTest) -> None:
    """SDO servers of the file are there, and no others."""
    for number in range(1, 0x80):
        index = 0x1200 + number
        request = multiplexed(0x40, index, 1).hex()
        if dut.eds.has(index, 1):
            dut.ask(f"read {index:04X}h:1", request, f"43 {request[2:8]} ????????")
        else:
            dut.ask(f"read {index:04X}h:1", request, aborted(index, 1, NO_OBJECT))


def servers_after_reset(dut: DeviceUnderTest) -> None:
    """Reset communication brings their identifiers of power-on back."""
    keys = [entry.key for entry in dut.eds.entries(0x1201, 0x127F) if entry.readable]
    if not keys:
        raise NotApplicableError("no SDO server but the default one (1200h) is in the EDS file")
    dut.reset(NmtCommand.RESET_COMMUNICATION)
    before = {key: dut.value(*key) for key in keys}
    dut.reset(NmtCommand.RESET_COMMUNICATION)
    for key, value in before.items():
        dut.reads("as before", *key, value)


def clients_are_stored(dut: DeviceUnderTest) -> None:
    """1280h and following, with 1010h:1 and reset communication."""
    keys = [entry.key for entry in dut.eds.entries(0x1280, 0x12FF) if entry.readable]
    if not keys:
        raise NotApplicableError("no SDO client (1280h) is in the EDS file")
    dut.needs_to_write((0x1010, 1))
    dut.needs_store()
    before = {key: dut.value(*key) for key in keys}
    dut.write(0x1010, 1, int.from_bytes(b"save", "little"))
    dut.reset(NmtCommand.RESET_COMMUNICATION)
    for key, value in before.items():
        dut.reads("as before", *key, value)


CASES: Final[Mapping[str, Callable[[DeviceUnderTest], None]]] = {
    "SDO 1": read_device_type,
    "SDO 2": read_and_write,
    "SDO 3": write_device_type,
    "SDO 4": read_write_only,
    "SDO 5": read_no_sub_index,
    "SDO 6": read_no_object,
    "SDO 7": unknown_command,
    "SDO 8": write_too_long,
    "SDO 9": write_too_short,
    "SDO 10": write_too_high,
    "SDO 11": write_too_low,
    "SDO 12": default_server,
    "SDO 13": four_bytes_need_no_segments,
    "SDO 14": lambda dut: segmented_download(dut, 0x100C),
    "SDO 15": lambda dut: segmented_download(dut, 0x1017),
    "SDO 16": segmented_upload,
    "SDO 17": wrong_toggle_bit,
    "SDO 18": all_segmented,
    "SDO 19": block_upload_of_four_bytes,
    "SDO 20": lambda dut: block_download(dut, 0x100C, _NO_CRC),
    "SDO 21": lambda dut: block_download(dut, 0x1017, _NO_CRC),
    "SDO 22": block_upload,
    "SDO 23": block_upload_with_crc,
    "SDO 24": lambda dut: block_download(dut, 0x100C, _WITH_CRC),
    "SDO 25": lambda dut: block_download(dut, 0x1017, _WITH_CRC),
    "SDO 26": wrong_block_size,
    "SDO 27": wrong_sequence_number,
    "SDO 28": further_servers,
    "SDO 29": servers_after_reset,
    "SDO 30": clients_are_stored,
}
