"""Bit times of a frame on the wire (ISO 11898-1), counted from its actual bits.

A classical frame is SOF, arbitration and control field, data, CRC-15, CRC delimiter, ACK slot and delimiter, 7 bit
EOF; after it the bus is taken for 3 more bits of intermission. From SOF to the end of the CRC sequence a stuff bit
follows every five equal bits. The count goes byte by byte through two tables (CRC-15; stuffing as an eight-state
automaton), because the hub does it for every frame.
"""

from __future__ import annotations

from functools import lru_cache

from hilbench.can.frame import EXTENDED_FLAG, REMOTE_FLAG, Frame

#: CRC delimiter, ACK slot, ACK delimiter, end of frame, intermission: never stuffed.
TRAILER_BITS = 1 + 1 + 1 + 7 + 3
#: Bits from SOF to the last bit of the CRC sequence, without data and stuff bits.
STUFFED_BITS_BASE = 34
STUFFED_BITS_EXTENDED = 54
#: What an error costs after the bit it hits: superposed error flags (at worst 6 + 6), delimiter (8), intermission (3).
ERROR_FRAME_BITS = 12 + 8 + 3

#: Data lengths of CAN FD, by DLC.
FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)

_CRC15_POLYNOMIAL = 0x4599
_STATES = 8  # (value of the last bit) * 4 + (length of its run - 1), runs 1 to 4
_AFTER_SOF = 0  # SOF is one dominant (0) bit
_HEADER_CACHE_LIMIT = 4096


def _stuff_step(state: int, bit: int) -> tuple[int, int]:
    """State after one more payload bit, and the stuff bits (0 or 1) that it caused."""
    value, run = divmod(state, 4)
    if bit != value:
        return bit * 4, 0
    if run == 3:  # the fifth equal bit: a complementary bit follows, which begins a new run
        return (1 - value) * 4, 1
    return state + 1, 0


def _stuff_bits(state: int, bits: int, count: int) -> tuple[int, int]:
    """State and number of stuff bits after the `count` low bits of `bits`, most significant first."""
    stuffed = 0
    for position in range(count - 1, -1, -1):
        state, more = _stuff_step(state, bits >> position & 1)
        stuffed += more
    return state, stuffed


def _crc_bits(crc: int, bits: int, count: int) -> int:
    for position in range(count - 1, -1, -1):
        feedback = crc >> 14 ^ (bits >> position & 1)
        crc = (crc << 1 & 0x7FFF) ^ (_CRC15_POLYNOMIAL if feedback else 0)
    return crc


def _stuff_table(count: int) -> list[list[tuple[int, int]]]:
    """`_stuff_bits` of all groups of `count` bits, by state: of one bit less with one more behind it."""
    table = [[(state, 0)] for state in range(_STATES)]
    for _ in range(count):
        table = [[(after, stuffed + more) for state, stuffed in row for after, more in _STEPS[state]] for row in table]
    return table


_STEPS = [[_stuff_step(state, bit) for bit in (0, 1)] for state in range(_STATES)]
# STUFF[state << 8 | byte] = stuff bits << 11 | next state << 8, so that the next look-up needs one "or".
STUFF = tuple(stuffed << 11 | following << 8 for row in _stuff_table(8) for following, stuffed in row)
STUFF_LAST_7 = tuple(stuffed for row in _stuff_table(7) for _, stuffed in row)
_CRC = tuple(_crc_bits(0, byte, 8) for byte in range(256))


def _crc_after_zero(crc: int) -> int:
    """The CRC register a byte of zeros later."""
    return (crc << 8 & 0x7FFF) ^ _CRC[crc >> 7]


def _crc_of_places() -> tuple[tuple[int, ...], ...]:
    """The CRC is linear: what each of eight data bytes adds to it at the end, by the byte's place."""
    places = [_CRC]
    for _ in range(7):
        places.insert(0, tuple(map(_crc_after_zero, places[0])))
    return tuple(places)


CRC_OF_PLACES = _crc_of_places()
_CRC_0, _CRC_1, _CRC_2, _CRC_3, _CRC_4, _CRC_5, _CRC_6, _CRC_7 = CRC_OF_PLACES

_headers: dict[tuple[int, int], tuple[int, int, int]] = {}


def header(can_id: int, length: int) -> tuple[int, int, int]:
    """(CRC, stuffing state << 8, bits of the frame without the stuff bits still to come) before the data.

    The CRC is that at the end of the frame, were all data zero.
    """
    remote = 1 if can_id & REMOTE_FLAG else 0
    if can_id & EXTENDED_FLAG:
        base, extension = can_id >> 18 & 0x7FF, can_id & 0x3FFFF
        # base identifier, SRR, IDE, identifier extension, RTR, r1, r0, DLC
        bits = base << 27 | 0b11 << 25 | extension << 7 | remote << 6 | length
        count, fixed = 38, STUFFED_BITS_EXTENDED + TRAILER_BITS
    else:
        bits = (can_id & 0x7FF) << 7 | remote << 6 | length  # identifier, RTR, IDE, r0, DLC
        count, fixed = 18, STUFFED_BITS_BASE + TRAILER_BITS
    state, stuffed = _stuff_bits(_AFTER_SOF, bits, count)
    # SOF is a 0 and the CRC register begins at 0: it changes nothing.
    crc = _crc_bits(0, bits, count)
    for _ in range(0 if remote else length):
        crc = _crc_after_zero(crc)
    found = (crc, state << 8, fixed + stuffed + (0 if remote else 8 * length))
    if len(_headers) >= _HEADER_CACHE_LIMIT:
        _headers.clear()
    _headers[can_id, length] = found
    return found


@lru_cache(128)  # some frames are the same in every cycle, and in one process wire and bench count each
def bits_on_wire(can_id: int, data: bytes) -> int:
    """Bit times of one classical frame, stuff bits and intermission included.

    `can_id` carries the kernel's flag bits; of a remote frame's `data` only the length (its DLC) counts.
    """
    length = len(data)
    crc, state, bits = _headers.get((can_id, length)) or header(can_id, length)
    stuff = STUFF
    if not can_id & REMOTE_FLAG:
        a, b, c, d, e, f, g, h = data if length == 8 else data.rjust(8, b"\0")  # zeros in front add nothing
        crc ^= _CRC_0[a] ^ _CRC_1[b] ^ _CRC_2[c] ^ _CRC_3[d] ^ _CRC_4[e] ^ _CRC_5[f] ^ _CRC_6[g] ^ _CRC_7[h]
        for byte in data:
            entry = stuff[state | byte]
            state = entry & 0x700
            bits += entry >> 11
    entry = stuff[state | crc >> 7]
    return bits + (entry >> 11) + STUFF_LAST_7[(entry & 0x700) >> 1 | crc & 0x7F]


def frame_bits(frame: Frame) -> int:
    """Bit times of `frame` on the wire: exact, stuff bits and 3 bits of intermission included."""
    return bits_on_wire(frame.can_id, frame.data)


def least_bits(data_bytes: int, extended: bool = False) -> int:
    """Bit times of a classical frame of `data_bytes` bytes (0 for a remote frame) without any stuff bit."""
    if not 0 <= data_bytes <= 8:
        raise ValueError(f"a classical frame has 0 to 8 data bytes, not {data_bytes}")
    return (STUFFED_BITS_EXTENDED if extended else STUFFED_BITS_BASE) + TRAILER_BITS + 8 * data_bytes


def worst_case_bits(data_bytes: int, extended: bool = False) -> int:
    """Most bit times of a classical frame of `data_bytes` bytes (0 for a remote frame).

    The first five equal bits take one stuff bit, every four further bits another one at worst
    (Davis, Burns, Bril, Lukkien: Controller Area Network schedulability analysis, 2007, eq. 1).
    """
    stuffable = (STUFFED_BITS_EXTENDED if extended else STUFFED_BITS_BASE) + 8 * data_bytes
    return least_bits(data_bytes, extended) + (stuffable - 1) // 4


def fd_bits_on_wire(can_id: int, data: bytes, bit_rate_switch: bool) -> tuple[int, int]:
    """(bit times at the nominal bit rate, bit times at the data bit rate) of a CAN FD frame (ISO 11898-1:2015).

    `len(data)` is one of `FD_LENGTHS`. Up to the end of the data the stuffing is that of a classical frame, then
    come stuff count and CRC with stuff bits at fixed places. The rate changes inside the BRS bit and the CRC delimiter;
    here the first counts as nominal, the second as data bit. Without a switch all bits are nominal.
    """
    dlc = FD_LENGTHS.index(len(data))
    if can_id & EXTENDED_FLAG:
        # base identifier, SRR, IDE, extension, RRS, FDF, res, BRS
        base, extension = can_id >> 18 & 0x7FF, can_id & 0x3FFFF
        head, count = (base << 20 | 0b11 << 18 | extension) << 4 | 0b0100 | bit_rate_switch, 35
    else:
        head, count = (can_id & 0x7FF) << 5 | 0b00100 | bit_rate_switch, 16  # identifier, RRS, IDE, FDF, res, BRS
    state, head_stuffed = _stuff_bits(_AFTER_SOF, head, count)
    state, fast_stuffed = _stuff_bits(state, dlc, 5)  # ESI (dominant: error active), DLC
    state <<= 8
    for byte in data:
        entry = STUFF[state | byte]
        state = entry & 0x700
        fast_stuffed += entry >> 11
    if state in (0x000, 0x400):  # a run of one: perhaps a stuff bit
        fast_stuffed -= _ends_on_stuff_bit(head, count, dlc, data)
    nominal = 1 + count + head_stuffed + TRAILER_BITS - 1
    crc_field = 4 + 17 + 6 if len(data) <= 16 else 4 + 21 + 7  # stuff count, CRC, fixed stuff bits
    fast = 5 + 8 * len(data) + fast_stuffed + crc_field + 1
    return (nominal, fast) if bit_rate_switch else (nominal + fast, 0)


def worst_case_fd_bits(data_bytes: int, extended: bool = False) -> tuple[int, int]:
    """Most (bit times at the nominal bit rate, at the data bit rate) of a CAN FD frame with bit rate switch.

    `data_bytes`: one of `FD_LENGTHS`. As `worst_case_bits` up to the end of the data; stuff bits are counted where they
    cost most, in the slow part, as far as there may be any.
    """
    if data_bytes not in FD_LENGTHS:
        raise ValueError(f"a CAN FD frame has one of {FD_LENGTHS} data bytes, not {data_bytes}")
    head = 35 if extended else 16
    body = 5 + 8 * data_bytes
    slow_stuffed, stuffed = head // 4, (head + body) // 4
    crc_field = 4 + 17 + 6 if data_bytes <= 16 else 4 + 21 + 7
    return 1 + head + slow_stuffed + TRAILER_BITS - 1, body + stuffed - slow_stuffed + crc_field + 1


def _ends_on_stuff_bit(head: int, count: int, dlc: int, data: bytes) -> int:
    """1 if the last bit before the stuff count calls for a stuff bit: the fixed one there takes its place."""
    stream = int.from_bytes(data, "big") | (head << 5 | dlc) << 8 * len(data)
    bits = count + 5 + 8 * len(data)
    state, _ = _stuff_bits(_AFTER_SOF, stream >> 1, bits - 1)
    return _stuff_step(state, stream & 1)[1]
