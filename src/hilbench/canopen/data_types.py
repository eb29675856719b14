"""CANopen's basic data types (CiA 301, 7.1): widths, byte order, encoding of one value."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache

Value = int | float | bytes | str

#: Placeholder of the node id in the values of an EDS file (CiA 306).
NODE_ID = "$NODEID"

BOOLEAN, INTEGER8, INTEGER16, INTEGER32, UNSIGNED8, UNSIGNED16, UNSIGNED32, REAL32 = range(0x01, 0x09)
VISIBLE_STRING, OCTET_STRING, UNICODE_STRING, TIME_OF_DAY, TIME_DIFFERENCE = range(0x09, 0x0E)
DOMAIN = 0x0F
INTEGER24, REAL64, INTEGER40, INTEGER48, INTEGER56, INTEGER64, UNSIGNED24 = range(0x10, 0x17)
UNSIGNED40, UNSIGNED48, UNSIGNED56, UNSIGNED64 = range(0x18, 0x1C)

#: Types that `struct` knows; little-endian on the wire.
STRUCT_CODES = {
    INTEGER8: "b", INTEGER16: "h", INTEGER32: "i", INTEGER64: "q",
    UNSIGNED8: "B", UNSIGNED16: "H", UNSIGNED32: "I", UNSIGNED64: "Q",
    REAL32: "f", REAL64: "d",
}  # fmt: skip
#: Integers whose width `struct` does not know, in bytes.
_ODD_WIDTHS = {
    INTEGER24: 3, INTEGER40: 5, INTEGER48: 6, INTEGER56: 7,
    UNSIGNED24: 3, UNSIGNED40: 5, UNSIGNED48: 6, UNSIGNED56: 7,
}  # fmt: skip
_SIGNED = {INTEGER8, INTEGER16, INTEGER24, INTEGER32, INTEGER40, INTEGER48, INTEGER56, INTEGER64}
_FLOATS = {REAL32, REAL64}
_STRINGS = {VISIBLE_STRING: "latin-1", UNICODE_STRING: "utf-16-le"}
#: TIME_OF_DAY and TIME_DIFFERENCE occupy 6 bytes; their value is kept as bytes.
_BYTES_WIDTHS = {TIME_OF_DAY: 6, TIME_DIFFERENCE: 6}


@dataclass(frozen=True, slots=True)
class DataType:
    """Encoding of one basic data type in SDO and PDO data."""

    code: int
    #: Bytes in SDO data; None: as many as there are (strings, DOMAIN).
    width: int | None

    @property
    def pdo_bits(self) -> int | None:
        """Bits in a PDO; None: does not go into a PDO. BOOLEAN takes one bit there and one byte in SDO data."""
        if self.code == BOOLEAN:
            return 1
        return None if self.width is None else 8 * self.width

    @property
    def is_number(self) -> bool:
        return self.is_integer or self.code in _FLOATS

    @property
    def is_integer(self) -> bool:
        return self.code == BOOLEAN or self.code in _ODD_WIDTHS or (self.code in STRUCT_CODES and not self.is_float)

    @property
    def is_float(self) -> bool:
        return self.code in _FLOATS

    @property
    def is_signed(self) -> bool:
        return self.code in _SIGNED

    @property
    def neutral(self) -> Value:
        """Default of an object without a given value: 0 or empty."""
        if self.is_float:
            return 0.0
        if self.is_integer:
            return 0
        return "" if self.code in _STRINGS else bytes(self.width or 0)

    def encode(self, value: Value) -> bytes:
        """SDO data of a value. Raises ValueError when the value is not of this type or out of its range."""
        try:
            if self.is_float:
                return struct.pack("<" + STRUCT_CODES[self.code], value)
            if self.is_integer:
                return int(value).to_bytes(self.width or 1, "little", signed=self.is_signed)
            if self.code in _STRINGS:
                return str(value).encode(_STRINGS[self.code])
        except (struct.error, OverflowError, TypeError, UnicodeEncodeError) as error:
            raise ValueError(f"{value!r} is not a value of data type {self.code:04X}h") from error
        if not isinstance(value, bytes | bytearray):
            raise ValueError(f"{value!r} is not a value of data type {self.code:04X}h")
        return bytes(value)

    def decode(self, data: bytes) -> Value:
        """Value of SDO data. Raises ValueError when the data are of another length than the type's."""
        if self.width is not None and len(data) != self.width:
            raise ValueError(f"{len(data)} bytes for data type {self.code:04X}h, expected {self.width}")
        if self.is_float:
            number: float = struct.unpack("<" + STRUCT_CODES[self.code], data)[0]
            return number
        if self.is_integer:
            return int.from_bytes(data, "little", signed=self.is_signed)
        if self.code in _STRINGS:
            return bytes(data).decode(_STRINGS[self.code], errors="replace").rstrip("\0")
        return bytes(data)

    def parse(self, text: str, node_id: int) -> Value:
        """Value of the text in an EDS file (CiA 306): numbers in any base, ``$NODEID+`` for COB-IDs, hex for bytes.

        Raises ValueError when the text is no such value.
        """
        try:
            return self._parse(text, node_id)
        except OverflowError as error:
            raise ValueError(f"'{text}' does not fit data type {self.code:04X}h") from error

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
        return text if self.code in _STRINGS else bytes.fromhex(text.removeprefix("0x"))

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
    if code == BOOLEAN:
        return DataType(code, 1)
    if code in STRUCT_CODES:
        return DataType(code, struct.calcsize("<" + STRUCT_CODES[code]))
    if code in _ODD_WIDTHS:
        return DataType(code, _ODD_WIDTHS[code])
    if code in _BYTES_WIDTHS:
        return DataType(code, _BYTES_WIDTHS[code])
    return DataType(code if code in _STRINGS or code == OCTET_STRING else DOMAIN, None)
