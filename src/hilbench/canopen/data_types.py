"""CANopen's basic data types (CiA 301, 7.1): widths, byte order, encoding of one value."""

from __future__ import annotations

import struct
from enum import IntEnum
from functools import cache
from typing import Self

Value = int | float | bytes | str

#: Placeholder of the node id in the values of an EDS file (CiA 306).
NODE_ID = "$NODEID"


class DataType(IntEnum):
    """A basic data type by its code in EDS files, and its encoding in SDO and PDO data, little-endian."""

    #: Bytes in SDO data; None: as many as there are (strings, DOMAIN).
    width: int | None
    #: Number of which kind, or encoding of a text; empty: bytes, also of the times.
    kind: str
    #: Letter of `struct`; empty for a type that it does not know.
    letter: str

    BOOLEAN = 0x01, 1, "unsigned"
    INTEGER8 = 0x02, 1, "signed", "b"
    INTEGER16 = 0x03, 2, "signed", "h"
    INTEGER32 = 0x04, 4, "signed", "i"
    UNSIGNED8 = 0x05, 1, "unsigned", "B"
    UNSIGNED16 = 0x06, 2, "unsigned", "H"
    UNSIGNED32 = 0x07, 4, "unsigned", "I"
    REAL32 = 0x08, 4, "real", "f"
    VISIBLE_STRING = 0x09, None, "latin-1"
    OCTET_STRING = 0x0A
    UNICODE_STRING = 0x0B, None, "utf-16-le"
    TIME_OF_DAY = 0x0C, 6
    TIME_DIFFERENCE = 0x0D, 6
    DOMAIN = 0x0F
    INTEGER24 = 0x10, 3, "signed"
    REAL64 = 0x11, 8, "real", "d"
    INTEGER40 = 0x12, 5, "signed"
    INTEGER48 = 0x13, 6, "signed"
    INTEGER56 = 0x14, 7, "signed"
    INTEGER64 = 0x15, 8, "signed", "q"
    UNSIGNED24 = 0x16, 3, "unsigned"
    UNSIGNED40 = 0x18, 5, "unsigned"
    UNSIGNED48 = 0x19, 6, "unsigned"
    UNSIGNED56 = 0x1A, 7, "unsigned"
    UNSIGNED64 = 0x1B, 8, "unsigned", "Q"

    def __new__(cls, code: int, width: int | None = None, kind: str = "", letter: str = "") -> Self:
        """A row of the table."""
        made = int.__new__(cls, code)
        made._value_ = code
        made.width, made.kind, made.letter = width, kind, letter
        return made

    @property
    def pdo_bits(self) -> int | None:
        """Bits in a PDO; None: does not go into a PDO. BOOLEAN takes one bit there and one byte in SDO data."""
        if self is DataType.BOOLEAN:
            return 1
        return None if self.width is None else 8 * self.width

    @property
    def is_number(self) -> bool:
        return self.is_integer or self.is_float

    @property
    def is_integer(self) -> bool:
        return self.kind in ("signed", "unsigned")

    @property
    def is_float(self) -> bool:
        return self.kind == "real"

    @property
    def is_signed(self) -> bool:
        return self.kind == "signed"

    @property
    def is_text(self) -> bool:
        return not self.is_number and self.kind != ""

    @property
    def neutral(self) -> Value:
        """Default of an object without a given value: 0 or empty."""
        if self.is_float:
            return 0.0
        if self.is_integer:
            return 0
        return "" if self.is_text else bytes(self.width or 0)

    def encode(self, value: Value) -> bytes:
        """SDO data of a value. Raises ValueError when the value is not of this type or out of its range."""
        try:
            if self.is_float:
                return struct.pack("<" + self.letter, value)
            if self.is_integer:
                return int(value).to_bytes(self.width or 1, "little", signed=self.is_signed)
            if self.is_text:
                return str(value).encode(self.kind)
        except (struct.error, OverflowError, TypeError, UnicodeEncodeError) as error:
            raise ValueError(f"{value!r} is not a value of data type {self:04X}h") from error
        if not isinstance(value, bytes | bytearray):
            raise ValueError(f"{value!r} is not a value of data type {self:04X}h")
        return bytes(value)

    def decode(self, data: bytes) -> Value:
        """Value of SDO data. Raises ValueError when the data are of another length than the type's."""
        if self.width is not None and len(data) != self.width:
            raise ValueError(f"{len(data)} bytes for data type {self:04X}h, expected {self.width}")
        if self.is_float:
            number: float = struct.unpack("<" + self.letter, data)[0]
            return number
        if self.is_integer:
            return int.from_bytes(data, "little", signed=self.is_signed)
        if self.is_text:
            return bytes(data).decode(self.kind, errors="replace").rstrip("\0")
        return bytes(data)

    def parse(self, text: str, node_id: int) -> Value:
        """Value of the text in an EDS file (CiA 306): numbers in any base, ``$NODEID+`` for COB-IDs, hex for bytes.

        Raises ValueError when the text is no such value.
        """
        try:
            return self._parse(text, node_id)
        except OverflowError as error:
            raise ValueError(f"'{text}' does not fit data type {self:04X}h") from error

    def _parse(self, text: str, node_id: int) -> Value:
        if self.is_float:
            if not text.lower().startswith("0x"):
                return float(text)
            return self.decode(int(text, 0).to_bytes(self.width or 4, "little"))  # the bits of IEEE 754
        if self.is_integer:
            return self._parse_integer(text, node_id)
        if self.width is not None:  # times: a number, or their bytes as they are on the wire
            is_number = len(text) != 2 * self.width
            return int(text, 0).to_bytes(self.width, "little") if is_number else bytes.fromhex(text)
        return text if self.is_text else bytes.fromhex(text.removeprefix("0x"))

    def _parse_integer(self, text: str, node_id: int) -> int:
        terms = text.replace(" ", "").upper().split("+")
        number = sum(node_id if term == NODE_ID else int(term, 0) for term in terms)
        bits = 8 * (self.width or 1)
        if self.is_signed and terms[0].startswith("0X") and 1 << (bits - 1) <= number < 1 << bits:
            number -= 1 << bits  # hexadecimal is the bit pattern
        self.encode(number)
        return number


@cache
def data_type(code: int) -> DataType:
    """Basic data type of an EDS type code; unknown (complex, manufacturer) types are DOMAIN: raw bytes."""
    return DataType(code) if code in set(DataType) else DataType.DOMAIN
