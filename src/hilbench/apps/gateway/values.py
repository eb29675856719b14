"""Values of CiA 309-3's data types: their texts, and their bytes as they go over SDO."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import isinf

from hilbench.apps.gateway.errors import GatewayError, RequestError
from hilbench.canopen.data_types import DataType, Value, data_type


@dataclass(frozen=True)
class TextForm:
    """Text format of the values of a data type."""

    parse: Callable[[str], bytes]
    show: Callable[[bytes], str]


def form(name: str) -> TextForm:
    """Text format of a data type by its name. Raises RequestError for a name that is none."""
    try:
        return _FORMS[name.lower()]
    except KeyError:
        raise RequestError(GatewayError.SYNTAX, f"data type '{name}', expected one of {', '.join(_FORMS)}") from None


def _parse(code: int, text: str) -> bytes:
    kind = data_type(code)
    try:
        value = float(text) if kind.is_float else int(text, 0)
        if kind.is_float and isinf(value) and "inf" not in text.lower():
            raise OverflowError
        return kind.encode(value)
    except (ValueError, OverflowError) as error:
        raise RequestError(GatewayError.SYNTAX, f"'{text[:40]}' is no value of this data type") from error


def _decode(code: int, data: bytes) -> Value:
    kind = data_type(code)
    if len(data) != kind.width:
        raise RequestError("0x06070010", f"{len(data)} bytes, expected {kind.width} of this data type")
    return kind.decode(data)


def _show_hexadecimal(code: int, data: bytes) -> str:
    return f"0x{int(_decode(code, data)):0{2 * len(data)}X}"


def _parse_hex(text: str) -> bytes:
    try:
        return bytes.fromhex(text)
    except ValueError as error:
        raise RequestError(GatewayError.SYNTAX, f"'{text}', expected hexadecimal bytes") from error


def _parse_base64(text: str) -> bytes:
    try:
        return base64.b64decode(text, validate=True)
    except binascii.Error as error:
        raise RequestError(GatewayError.SYNTAX, f"'{text[:40]}', expected base64 (RFC 2045)") from error


def _parse_time(text: str) -> bytes:
    """Days and milliseconds of the day: `ms days`, 28 of 32 bits and 16 bits."""
    try:
        days, milliseconds = map(int, text.split())
        if milliseconds >= 1 << 28:
            raise OverflowError
        return milliseconds.to_bytes(4, "little") + days.to_bytes(2, "little")
    except (ValueError, OverflowError):
        raise RequestError(GatewayError.SYNTAX, f"'{text[:40]}', expected days and milliseconds") from None


def _show_time(data: bytes) -> str:
    if len(data) != 6:
        raise RequestError("0x06070010", f"{len(data)} bytes, expected 6 of this data type")
    milliseconds = int.from_bytes(data[:4], "little") & 0x0FFF_FFFF
    return f"{int.from_bytes(data[4:], 'little')} {milliseconds}"


def _show_text(data: bytes) -> str:
    text = data.decode("latin-1").rstrip("\0").replace('"', '""')
    return f'"{text}"' if not text or any(c.isspace() or c == '"' for c in text) else text


def _number(code: int) -> TextForm:
    return TextForm(partial(_parse, code), lambda data: str(_decode(code, data)))


def _hexadecimal(code: int) -> TextForm:
    return TextForm(partial(_parse, code), partial(_show_hexadecimal, code))


_BASE64 = TextForm(_parse_base64, lambda data: base64.b64encode(data).decode("ascii"))
_TIME = TextForm(_parse_time, _show_time)

#: By the names of CiA 309-3; x… and hex are CANopenNode's.
_FORMS = {
    "b": TextForm(partial(_parse, DataType.BOOLEAN), lambda data: str(int(_decode(DataType.BOOLEAN, data) != 0))),
    "i8": _number(DataType.INTEGER8), "i16": _number(DataType.INTEGER16),
    "i32": _number(DataType.INTEGER32), "i64": _number(DataType.INTEGER64),
    "u8": _number(DataType.UNSIGNED8), "u16": _number(DataType.UNSIGNED16),
    "u32": _number(DataType.UNSIGNED32), "u64": _number(DataType.UNSIGNED64),
    "x8": _hexadecimal(DataType.UNSIGNED8), "x16": _hexadecimal(DataType.UNSIGNED16),
    "x32": _hexadecimal(DataType.UNSIGNED32), "x64": _hexadecimal(DataType.UNSIGNED64),
    "r32": _number(DataType.REAL32), "r64": _number(DataType.REAL64),
    "t": _TIME, "td": _TIME,
    "vs": TextForm(lambda text: text.encode("latin-1", errors="replace"), _show_text),
    "os": _BASE64, "us": _BASE64, "d": _BASE64,
    "hex": TextForm(_parse_hex, lambda data: data.hex(" ").upper()),
}  # fmt: skip
