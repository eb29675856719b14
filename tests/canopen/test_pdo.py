"""The PDO codec, against the encoding rules of CiA 301, 7.1 written out here."""

from __future__ import annotations

import struct

import pytest
from canopen.objectdictionary import ODVariable
from hypothesis import given
from hypothesis import strategies as st

from hilbench.canopen.pdo import PdoMap, mapping_value

#: Type code → (bits, signed); the widths that make a PDO.
INTEGERS = {
    0x02: (8, True), 0x03: (16, True), 0x10: (24, True), 0x04: (32, True), 0x12: (40, True), 0x13: (48, True),
    0x14: (56, True), 0x15: (64, True), 0x05: (8, False), 0x06: (16, False), 0x16: (24, False), 0x07: (32, False),
    0x18: (40, False), 0x19: (48, False), 0x1A: (56, False), 0x1B: (64, False),
}  # fmt: skip


def of_type(code: int, index: int = 0x2000) -> ODVariable:
    made = ODVariable(f"object {index:X}", index)
    made.data_type = code
    return made


@st.composite
def layouts(draw: st.DrawFn) -> list[tuple[int, int]]:
    """Types and values that fill up to 8 bytes."""
    chosen: list[tuple[int, int]] = []
    room = 64
    while room and draw(st.booleans()):
        code = draw(st.sampled_from([code for code, (bits, _) in INTEGERS.items() if bits <= room]))
        bits, signed = INTEGERS[code]
        low = -(1 << bits - 1) if signed else 0
        chosen.append((code, draw(st.integers(low, low + (1 << bits) - 1))))
        room -= bits
    return chosen


@given(layouts())
def test_integers_stand_one_after_the_other_little_endian(layout: list[tuple[int, int]]) -> None:
    pdo = PdoMap(0x181, 1, [of_type(code) for code, _ in layout])
    values = tuple(value for _, value in layout)
    expected = b"".join(
        value.to_bytes(INTEGERS[code][0] // 8, "little", signed=INTEGERS[code][1]) for code, value in layout
    )
    assert pdo.pack(values) == expected
    assert pdo.unpack(expected) == values
    assert pdo.size == len(expected)


@given(st.floats(width=32, allow_nan=False))
def test_reals(value: float) -> None:
    pdo = PdoMap(0x181, 1, [of_type(0x08), of_type(0x03)])
    assert pdo.pack((value, -3)) == struct.pack("<fh", value, -3)
    assert pdo.unpack(struct.pack("<fh", value, -3)) == (value, -3)


def test_mapping_entry() -> None:
    assert mapping_value(of_type(0x10, 0x60FF)) == 0x60FF0018
    assert PdoMap(0x181, 1, [of_type(0x03, 0x6077), of_type(0x04, 0x6064)]).mapping == [0x60770010, 0x60640020]


@pytest.mark.parametrize("code", [0x09, 0x0A, 0x0F, 0x40])
def test_types_that_do_not_go_into_a_pdo(code: int) -> None:
    with pytest.raises(ValueError, match=f"data type {code:04X}h"):
        PdoMap(0x181, 1, [of_type(code)])


def test_a_boolean_is_one_bit_and_what_follows_it_stands_at_the_next() -> None:
    pdo = PdoMap(0x181, 1, [of_type(0x01), of_type(0x03), of_type(0x01)])
    assert [entry & 0xFF for entry in pdo.mapping] == [1, 16, 1]
    assert pdo.pack((1, -2, 1)) == (1 | 0xFFFE << 1 | 1 << 17).to_bytes(3, "little")
    assert pdo.unpack(pdo.pack((1, -2, 0))) == (1, -2, 0)
    with pytest.raises(ValueError, match="181h"):
        pdo.pack((2, 0, 0))


def test_more_than_8_bytes() -> None:
    with pytest.raises(ValueError, match="maps 9 bytes, expected at most 8"):
        PdoMap(0x181, 1, [of_type(0x1B), of_type(0x05)])


@pytest.mark.parametrize(("code", "value"), [(0x03, 32768), (0x03, 1.5), (0x05, -1), (0x10, 1 << 23), (0x16, -1)])
def test_value_that_does_not_fit_is_named(code: int, value: float) -> None:
    with pytest.raises(ValueError, match=r"181h|not a value"):
        PdoMap(0x181, 1, [of_type(code)]).pack((value,))


@pytest.mark.parametrize(("kind", "period"), [(0, 0), (1, 1), (240, 240), (254, 0), (255, 0)])
def test_period(kind: int, period: int) -> None:
    assert PdoMap(0x181, kind, []).period == period
