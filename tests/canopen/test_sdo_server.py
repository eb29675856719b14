"""SDO on the wire beyond the conformance cases, request and answer byte by byte (CiA 301, 7.2.4.3)."""

from __future__ import annotations

from binascii import crc_hqx

import pytest
from tests.canopen.device_under_test import DeviceUnderTest

from hilbench.canopen.object_store import SdoAbort

LONG = bytes(range(256)) * 5


@pytest.mark.parametrize(
    ("request_bytes", "answer"),
    [
        pytest.param("40 00 20 00 00000000", "4b002000f9ff0000", id="expedited upload of 2 bytes, negative"),
        pytest.param("2b 00 20 00 2a000000", "6000200000000000", id="expedited download"),
        pytest.param("22 00 20 00 2a000000", "6000200000000000", id="expedited download without size"),
        pytest.param("40 05 00 00 00000000", "8005000000000206", id="a dummy is no object"),
        pytest.param("40 18 10 07 00000000", "8018100711000906", id="no sub-index in a record"),
        pytest.param("40 03 10 63 00000000", "8003106311000906", id="no sub-index in an array"),
        pytest.param("21 08 10 00 20000000", "8008100002000106", id="segmented write of const, refused at once"),
        pytest.param("21 00 20 00 09000000", "8000200012000706", id="announced size too long"),
        pytest.param("2b 00 20 00 9bff0000", "8000200032000906", id="below the low limit, negative"),
        pytest.param("60 00 00 00 00000000", "8000000001000405", id="segment of no transfer"),
    ],
)
def test_request_and_answer(dut: DeviceUnderTest, request_bytes: str, answer: str) -> None:
    assert dut.sdo(request_bytes) == answer


def test_segmented_download_takes_the_value_with_the_last_segment(dut: DeviceUnderTest) -> None:
    assert dut.sdo("21 02 20 00 09000000") == "6002200000000000"
    assert dut.sdo("00" + b"quick b".hex()) == "2000000000000000"
    assert dut.device.cell(0x2002).value == "abc"
    assert dut.sdo("1b" + b"ro".hex() + "0000000000") == "3000000000000000"
    assert dut.device.cell(0x2002).value == "quick bro"


@pytest.mark.parametrize(("announced", "abort"), [(8, "13000706"), (3, "12000706")])
def test_download_of_another_size_than_announced_is_refused(dut: DeviceUnderTest, announced: int, abort: str) -> None:
    dut.sdo(f"21 02 20 00 {announced:02x}000000")
    assert dut.sdo("05" + b"12345".hex() + "0000")[8:] == abort
    assert dut.device.cell(0x2002).value == "abc"


def test_client_abort_ends_the_transfer_without_an_answer(dut: DeviceUnderTest) -> None:
    dut.sdo("21 02 20 00 09000000")
    assert dut.send(0x605, "8002200000000405") == []
    assert dut.sdo("00" + b"1234567".hex())[8:] == "01000405"


@pytest.mark.parametrize("data", ["", "40001000", "4000100000000000"[:14]])
def test_short_requests_are_ignored(dut: DeviceUnderTest, data: str) -> None:
    assert dut.send(0x605, data) == []


def test_application_refuses_before_the_value_is_taken(dut: DeviceUnderTest) -> None:
    def refuse(value: object) -> None:
        raise SdoAbort(0x08000022)

    dut.device.cell(0x2000).on_write = refuse
    assert dut.write(0x2000, 0, 5, 2) == 0x08000022
    assert dut.device.cell(0x2000).value == -7


def test_errors_of_the_application_are_not_hidden_in_an_abort(dut: DeviceUnderTest) -> None:
    def fail(value: object) -> None:
        raise KeyError("a mistake")

    dut.device.cell(0x2000).on_write = fail
    with pytest.raises(KeyError, match="a mistake"):
        dut.write(0x2000, 0, 5, 2)


def test_real_and_odd_widths(dut: DeviceUnderTest) -> None:
    assert dut.sdo("40 06 20 00 00000000") == "430620000000c03f"
    assert dut.sdo("40 04 20 00 00000000") == "47042000feffff00"
    assert dut.write(0x2004, 0, -8388608, 3) == 0
    assert dut.device.cell(0x2004).value == -8388608


def begin_block_upload(dut: DeviceUnderTest, blksize: int) -> None:
    dut.device.cell(0x2003).value = LONG
    assert dut.sdo(f"a4 03 20 00 {blksize:02x}000000") == "c6032000" + len(LONG).to_bytes(4, "little").hex()


def test_block_upload(dut: DeviceUnderTest) -> None:
    begin_block_upload(dut, 127)
    received = b""
    answers = dut.send(0x605, "a300000000000000")
    while True:
        segments = [bytes.fromhex(data) for _, data in answers]
        assert [segment[0] & 0x7F for segment in segments] == list(range(1, len(segments) + 1))
        received += b"".join(segment[1:] for segment in segments)
        answers = dut.send(0x605, bytes((0xA2, len(segments), 127, 0, 0, 0, 0, 0)))
        if segments[-1][0] & 0x80:
            break
    [(_, end)] = answers
    unused = int(end[:2], 16) >> 2 & 7
    assert received[: len(received) - unused] == LONG
    assert bytes.fromhex(end)[1:3] == crc_hqx(LONG, 0).to_bytes(2, "little")
    assert dut.send(0x605, "a100000000000000") == []
    assert dut.send(0x605, "a100000000000000")[0][1][8:] == "01000405"


def test_block_upload_repeats_from_the_last_confirmed_segment(dut: DeviceUnderTest) -> None:
    begin_block_upload(dut, 4)
    first = dut.send(0x605, "a300000000000000")
    again = dut.send(0x605, "a202040000000000")
    assert [data[2:] for _, data in again[:2]] == [data[2:] for _, data in first[2:]]


def test_short_data_below_the_threshold_come_by_plain_upload(dut: DeviceUnderTest) -> None:
    assert dut.sdo("a4 00 10 00 7f040000") == "4300100092010200"


def download_block(dut: DeviceUnderTest, data: bytes, lost: int | None = None) -> str:
    """Block download of `data` in one block; segment `lost` (from 1) is missing the first time."""
    assert dut.sdo("c6 03 20 00" + len(data).to_bytes(4, "little").hex())[:10] == "a40320007f"
    segments = [data[at : at + 7].ljust(7, b"\0") for at in range(0, len(data), 7)]
    start = 0
    while start < len(segments):
        block = segments[start : start + 127]
        answer: list[tuple[int, str]] = []
        for number, segment in enumerate(block, 1):
            if start + number == lost:
                lost = None
                continue
            last = 0x80 if start + number == len(segments) else 0
            answer = dut.send(0x605, bytes((number | last,)) + segment)
        [(_, confirmation)] = answer
        assert confirmation[:2] == "a2"
        start += int(confirmation[2:4], 16)
    unused = -len(data) % 7
    end = bytes((0xC1 | unused << 2,)) + crc_hqx(data, 0).to_bytes(2, "little") + bytes(5)
    return dut.sdo(end.hex())


@pytest.mark.parametrize("lost", [None, 1, 3, 126, 130])
def test_block_download(dut: DeviceUnderTest, lost: int | None) -> None:
    assert download_block(dut, LONG, lost) == "a100000000000000"
    assert dut.device.cell(0x2003).value == LONG


def test_block_download_with_wrong_checksum_is_refused(dut: DeviceUnderTest) -> None:
    dut.sdo("c6 03 20 00 07000000")
    assert dut.send(0x605, "81" + b"1234567".hex())[0][1][:4] == "a201"
    assert dut.sdo("c1 0000 0000000000")[8:] == "04000405"
    assert dut.device.cell(0x2003).value == b""


@pytest.mark.parametrize(("state", "answers"), [(2, False), (128, True), (1, True)])
def test_sdo_is_answered_in_pre_operational_and_operational_only(
    dut: DeviceUnderTest, state: int, answers: bool
) -> None:
    dut.nmt(state)
    assert bool(dut.send(0x605, "4000100000000000")) is answers
