"""wire.py against a plain reading of ISO 11898-1, bit by bit, written independently of it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilbench.can.frame import EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.can.wire import FD_LENGTHS, fd_bits_on_wire, frame_bits, least_bits, worst_case_bits, worst_case_fd_bits


def binary(value: int, width: int) -> str:
    return format(value, f"0{width}b") if width else ""


def crc15(bits: str) -> str:
    """Remainder of the polynomial division by x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1, as on paper."""
    divisor = "1100010110011001"
    dividend = [int(bit) for bit in bits + "0" * 15]
    for start in range(len(bits)):
        if dividend[start]:
            for offset, bit in enumerate(divisor):
                dividend[start + offset] ^= int(bit)
    return "".join(map(str, dividend[-15:]))


def stuffed(bits: str) -> str:
    sent = ""
    for bit in bits:
        sent += bit
        if sent[-5:] in ("00000", "11111") and run_ends(sent) % 5 == 0:
            sent += "1" if bit == "0" else "0"
    return sent


def run_ends(sent: str) -> int:
    return len(sent) - len(sent.rstrip(sent[-1]))


def header(can_id: int, dlc: int) -> str:
    remote = "1" if can_id & REMOTE_FLAG else "0"
    if can_id & EXTENDED_FLAG:
        identifier = binary(can_id & 0x1FFFFFFF, 29)
        return "0" + identifier[:11] + "11" + identifier[11:] + remote + "00" + binary(dlc, 4)
    return "0" + binary(can_id & 0x7FF, 11) + remote + "00" + binary(dlc, 4)


def bits_by_hand(can_id: int, data: bytes) -> int:
    payload = "" if can_id & REMOTE_FLAG else "".join(binary(byte, 8) for byte in data)
    covered = header(can_id, len(data)) + payload
    return len(stuffed(covered + crc15(covered)) + "1" + "01" + "1111111" + "111")


base_ids = st.integers(0, 0x7FF)
extended_ids = st.integers(0, 0x1FFFFFFF).map(lambda identifier: identifier | EXTENDED_FLAG)
# Long runs of equal bits are where stuffing happens: plain random bytes seldom have them.
runs = st.lists(st.sampled_from([0x00, 0xFF, 0x1F, 0xF8, 0x07, 0x83, 0x7C]), max_size=8).map(bytes)
classical = st.tuples(base_ids | extended_ids, st.binary(max_size=8) | runs, st.booleans())


@given(classical)
def test_bits_are_those_of_the_frame_written_out(frame: tuple[int, bytes, bool]) -> None:
    can_id, data, remote = frame
    if remote:
        can_id, data = can_id | REMOTE_FLAG, bytes(len(data))
    bits = frame_bits(Frame(can_id, data))
    assert bits == bits_by_hand(can_id, data)
    carried = 0 if remote else len(data)
    extended = bool(can_id & EXTENDED_FLAG)
    assert least_bits(carried, extended) <= bits <= worst_case_bits(carried, extended)


@pytest.mark.parametrize(("data_bytes", "least", "worst"), [(0, 47, 55), (4, 79, 95), (6, 95, 115), (8, 111, 135)])
def test_limits_of_the_design(data_bytes: int, least: int, worst: int) -> None:
    assert least_bits(data_bytes) == least
    assert worst_case_bits(data_bytes) == worst


def test_extended_limits() -> None:
    assert least_bits(8, extended=True) == 131
    assert worst_case_bits(8, extended=True) == 160


@pytest.mark.parametrize("data_bytes", [-1, 9])
def test_lengths_no_classical_frame_has(data_bytes: int) -> None:
    with pytest.raises(ValueError, match="0 to 8"):
        least_bits(data_bytes)
    with pytest.raises(ValueError, match="0 to 8"):
        worst_case_bits(data_bytes)


def test_a_stuff_bit_after_the_last_bit_of_the_crc_counts() -> None:
    """Some frame ends its CRC with five equal bits: the stuff bit stands before the CRC delimiter."""
    for identifier in range(0x800):
        covered = header(identifier, 0)
        body = covered + crc15(covered)
        if len(stuffed(body)) > len(stuffed(body[:-1])) + 1:
            assert frame_bits(Frame(identifier, b"")) == bits_by_hand(identifier, b"")
            return
    pytest.fail("no such frame found")


def fd_bits_by_hand(can_id: int, data: bytes, switch: bool) -> int:
    """All bits of an FD frame together, whatever their rate."""
    identifier = binary(can_id & 0x1FFFFFFF, 29)
    arbitration = identifier[:11] + "11" + identifier[11:] + "0" if can_id & EXTENDED_FLAG else identifier[18:] + "00"
    control = "10" + ("1" if switch else "0") + "0" + binary(FD_LENGTHS.index(len(data)), 4)
    body = "0" + arbitration + control + "".join(binary(byte, 8) for byte in data)
    sent = stuffed(body)
    if len(sent) > len(stuffed(body[:-1])) + 1:
        sent = sent[:-1]  # the fixed stuff bit of the CRC field stands in its place
    crc_field = 0
    for position in range(4 + (17 if len(data) <= 16 else 21)):
        crc_field += 2 if position % 4 == 0 else 1
    return len(sent) + crc_field + 1 + 2 + 7 + 3


@given(
    base_ids | extended_ids,
    st.sampled_from(FD_LENGTHS).flatmap(lambda n: st.binary(min_size=n, max_size=n) | st.just(bytes(n))),
    st.booleans(),
)
def test_fd_bits(can_id: int, data: bytes, switch: bool) -> None:
    nominal, fast = fd_bits_on_wire(can_id, data, switch)
    assert nominal + fast == fd_bits_by_hand(can_id, data, switch)
    assert (fast == 0) is (not switch)
    if switch:
        most = worst_case_fd_bits(len(data), bool(can_id & EXTENDED_FLAG))
        for slower in (1, 2, 8):
            assert slower * nominal + fast <= slower * most[0] + most[1]


@pytest.mark.parametrize(("can_id", "data"), [(120, b""), (120, bytes.fromhex("f878787878787878"))])
def test_the_worst_case_of_an_fd_frame_is_hardly_more_than_there_is(can_id: int, data: bytes) -> None:
    """FDF, BRS and ESI are given, and keep three stuff bits from standing where they might."""
    assert sum(worst_case_fd_bits(len(data))) - sum(fd_bits_on_wire(can_id, data, True)) in (2, 3)


def test_lengths_no_fd_frame_has() -> None:
    for data_bytes in (-1, 9, 65):
        with pytest.raises(ValueError, match="CAN FD"):
            worst_case_fd_bits(data_bytes)
