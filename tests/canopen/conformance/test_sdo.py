"""SDO cases of the conformance test: request and answer byte by byte."""

from __future__ import annotations

from binascii import crc_hqx

import pytest
from tests.canopen.device_under_test import DeviceUnderTest, DriveUnderTest

case = pytest.mark.case

NAME = b"hilbench servo"
REQUEST, ANSWER = 0x605, 0x585


def segment(head: int, data: bytes) -> str:
    return (bytes((head,)) + data.ljust(7, b"\0")).hex()


def crc(data: bytes) -> str:
    return crc_hqx(data, 0).to_bytes(2, "little").hex()


def block_answers(drive: DriveUnderTest, request: str) -> list[str]:
    """What the server says to a request of a block transfer: none, one or many frames."""
    frames = drive.send(REQUEST, request.replace(" ", ""))
    assert all(can_id == ANSWER for can_id, _ in frames)
    return [data for _, data in frames]


@case("SDO 1")
def test_expedited_upload(drive: DriveUnderTest) -> None:
    assert drive.sdo("40 00 10 00 00000000") == "4300100092010200"


@case("SDO 2")
@pytest.mark.parametrize(
    ("head", "multiplexer", "answer", "value"),
    [("2b", "17 10 00", "4b", "e803"), ("2b", "15 10 00", "4b", "0a00"), ("23", "16 10 04", "43", "64000700")],
)
def test_read_and_write(drive: DriveUnderTest, head: str, multiplexer: str, answer: str, value: str) -> None:
    packed = multiplexer.replace(" ", "")
    assert drive.sdo(f"40 {multiplexer} 00000000") == f"{answer}{packed}00000000"
    assert drive.sdo(f"{head} {multiplexer} {value:0<8}") == f"60{packed}00000000"
    assert drive.sdo(f"40 {multiplexer} 00000000") == f"{answer}{packed}{value:0<8}"


@case("SDO 3")
def test_write_to_read_only(drive: DriveUnderTest) -> None:
    assert drive.sdo("23 00 10 00 92010200") == "8000100002000106"


@case("SDO 4")
def test_read_of_write_only(dut: DeviceUnderTest) -> None:
    assert dut.sdo("40 01 20 00 00000000") == "8001200001000106"


@case("SDO 5")
def test_no_sub_index(drive: DriveUnderTest) -> None:
    assert drive.sdo("40 00 10 01 00000000") == "8000100111000906"


@case("SDO 6")
def test_no_object(drive: DriveUnderTest) -> None:
    assert drive.sdo("40 04 10 00 00000000") == "8004100000000206"


@case("SDO 7")
def test_unknown_command_specifier(drive: DriveUnderTest) -> None:
    drive.sdo("40 17 10 00 00000000")
    assert drive.sdo("e0 00 10 00 00000000") == "8000100001000405"


@case("SDO 8")
@pytest.mark.parametrize("multiplexer", ["03 10 00", "17 10 00"])
def test_too_long(drive: DriveUnderTest, multiplexer: str) -> None:
    assert drive.sdo(f"23 {multiplexer} 00000000") == f"80{multiplexer.replace(' ', '')}12000706"


@case("SDO 9")
@pytest.mark.parametrize("multiplexer", ["05 10 00", "17 10 00"])
def test_too_short(drive: DriveUnderTest, multiplexer: str) -> None:
    assert drive.sdo(f"2f {multiplexer} 80000000") == f"80{multiplexer.replace(' ', '')}13000706"


@case("SDO 10")
@pytest.mark.parametrize(
    ("request_bytes", "answer"),
    [
        ("2f 03 10 00 ff000000", "8003100030000906"),  # one value only is allowed: 0
        ("2f 19 10 00 f1000000", "8019100031000906"),
    ],
)
def test_too_high(drive: DriveUnderTest, request_bytes: str, answer: str) -> None:
    assert drive.sdo(request_bytes) == answer


@case("SDO 11")
def test_too_low(drive: DriveUnderTest) -> None:
    assert drive.sdo("23 83 60 00 00000000") == "8083600032000906"


@case("SDO 12")
def test_default_sdo_server(drive: DriveUnderTest) -> None:
    assert drive.sdo("40 00 12 01 00000000") == "4300120105060000"
    assert drive.sdo("40 00 12 02 00000000") == "4300120285050000"


@case("SDO 13")
def test_four_bytes_need_no_segments(drive: DriveUnderTest) -> None:
    assert drive.sdo("40 00 10 00 00000000") == "4300100092010200"
    assert drive.sdo("60 00000000000000") == "8000100001000405"


@case("SDO 15")
def test_segmented_download(drive: DriveUnderTest) -> None:
    assert drive.sdo("21 17 10 00 02000000") == "6017100000000000"
    assert drive.sdo("0b e803 0000000000") == "2000000000000000"
    assert drive.sdo("40 17 10 00 00000000") == "4b171000e8030000"


@case("SDO 16")
def test_segmented_upload_of_two_segments(drive: DriveUnderTest) -> None:
    assert drive.sdo("40 08 10 00 00000000") == "410810000e000000"
    assert drive.sdo("60 00000000000000") == segment(0x00, NAME[:7])
    assert drive.sdo("70 00000000000000") == segment(0x11, NAME[7:])


@case("SDO 17")
def test_toggle_bit_that_does_not_alternate(drive: DriveUnderTest) -> None:
    drive.sdo("40 08 10 00 00000000")
    assert drive.sdo("70 00000000000000") == "8008100000000305"
    drive.sdo("40 08 10 00 00000000")
    drive.sdo("60 00000000000000")
    assert drive.sdo("60 00000000000000") == "8008100000000305"
    assert drive.sdo("70 00000000000000") == "8008100001000405"  # the transfer has ended


@case("SDO 18")
def test_segmented_upload_with_a_part_segment(drive: DriveUnderTest) -> None:
    assert drive.sdo("40 09 10 00 00000000") == "4109100009000000"
    assert drive.sdo("60 00000000000000") == segment(0x00, b"simulat")
    assert drive.sdo("70 00000000000000") == segment(0x1B, b"ed")
    assert drive.sdo("60 00000000000000") == "8009100001000405"  # nothing is left


@case("SDO 19")
def test_block_upload_of_four_bytes_without_crc(drive: DriveUnderTest) -> None:
    assert drive.sdo("a0 00 10 00 14000000") == "c600100004000000"
    assert drive.sdo("a3 00000000000000") == "8192010200000000"
    assert drive.sdo("a2 01 14 0000000000") == "cd00000000000000"
    assert block_answers(drive, "a1 00000000000000") == []


@case("SDO 21")
def test_block_download_without_crc(drive: DriveUnderTest) -> None:
    assert drive.sdo("c2 17 10 00 02000000") == "a41710007f000000"
    assert drive.sdo("81 e803 0000000000") == "a2017f0000000000"
    assert drive.sdo("d5 0000 0000000000") == "a100000000000000"
    assert drive.sdo("40 17 10 00 00000000") == "4b171000e8030000"


@case("SDO 22")
def test_block_upload_without_crc(drive: DriveUnderTest) -> None:
    assert drive.sdo("a0 08 10 00 14000000") == "c60810000e000000"
    assert block_answers(drive, "a3 00000000000000") == [segment(0x01, NAME[:7]), segment(0x82, NAME[7:])]
    assert drive.sdo("a2 02 14 0000000000") == "c100000000000000"
    assert block_answers(drive, "a1 00000000000000") == []


@case("SDO 23")
def test_block_upload_with_crc(drive: DriveUnderTest) -> None:
    assert drive.sdo("a4 09 10 00 14000000") == "c609100009000000"
    assert block_answers(drive, "a3 00000000000000") == [segment(0x01, b"simulat"), segment(0x82, b"ed")]
    assert drive.sdo("a2 02 14 0000000000") == f"d5{crc(b'simulated')}0000000000"
    assert block_answers(drive, "a1 00000000000000") == []
    assert drive.sdo("40 00 10 00 00000000") == "4300100092010200"


@case("SDO 25")
def test_block_download_with_crc(drive: DriveUnderTest) -> None:
    assert drive.sdo("c6 17 10 00 02000000") == "a41710007f000000"
    assert drive.sdo("81 e803 0000000000") == "a2017f0000000000"
    assert drive.sdo(f"d5 {crc(bytes.fromhex('e803'))} 0000000000") == "a100000000000000"
    assert drive.sdo("40 17 10 00 00000000") == "4b171000e8030000"


@case("SDO 26")
@pytest.mark.parametrize("size", ["80", "00", "ff"])
def test_wrong_block_size(drive: DriveUnderTest, size: str) -> None:
    assert drive.sdo(f"a0 00 10 00 {size}000000") == "8000100002000405"


@case("SDO 27")
def test_wrong_sequence_number(drive: DriveUnderTest) -> None:
    drive.sdo("a0 00 10 00 14000000")
    drive.sdo("a3 00000000000000")
    assert drive.sdo("a2 80 14 0000000000") == "8000100003000405"


@case("SDO 28")
def test_no_further_sdo_servers(drive: DriveUnderTest) -> None:
    for number in range(0x01, 0x80):
        assert drive.sdo(f"40 {number:02x} 12 01 00000000") == f"80{number:02x}120100000206"
