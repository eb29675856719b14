"""Requests of CiA 309-3 as text: commands, values of data types by their names, and errors (internal error codes)."""

from __future__ import annotations

import base64
import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from math import isinf
from typing import Final

from hilbench.canopen.data_types import DataType, Value

_LINE: Final = re.compile(r"^\s*\[\s*([0-9]{1,10}|0x[0-9A-Fa-f]{1,8})\s*\]\s*(.*)$")
_MOST: Final = 0xFFFF_FFFF


class GatewayError(IntEnum):
    """Error codes of the gateway itself."""

    NOT_SUPPORTED = 100
    SYNTAX = 101
    STATE = 102
    TIMED_OUT = 103
    NO_DEFAULT_NET = 104
    NO_DEFAULT_NODE = 105
    UNSUPPORTED_NET = 106
    UNSUPPORTED_NODE = 107
    HEARTBEAT_LOST = 203
    LSS_MANUFACTURER = 501
    LSS_NODE_ID = 502
    LSS_BIT_RATE = 503
    LSS_STORE = 504
    LSS_MEDIA = 505


class RequestError(Exception):
    """A request that ends with an error; `code` as it is sent, `comment` for a person."""

    def __init__(self, code: GatewayError | str, comment: str) -> None:
        super().__init__(comment)
        self.code = str(int(code)) if isinstance(code, GatewayError) else code
        self.comment = comment


@dataclass(frozen=True)
class Request:
    """One request as it was sent; None: the session's default."""

    sequence: int
    net: int | None
    node: int | None
    words: list[str]

    def number(self, place: int, most: int = _MOST) -> int:
        """The word at a place, as a number up to `most`. Raises RequestError."""
        try:
            return _number(self.words[place], 0, most)
        except IndexError:
            raise RequestError(GatewayError.SYNTAX, f"{self.words[0]}: too few arguments") from None


def sequence_of(line: str) -> int | None:
    """The sequence number that a line begins with; None: it has none, and can't be answered to."""
    found = _LINE.match(line)
    return None if found is None else _sequence(found[1])


def parse(line: str) -> Request | None:
    """The request in a line, None for one that has only a comment. Raises RequestError."""
    try:
        words = _split(line)
    except ValueError as error:
        raise RequestError(GatewayError.SYNTAX, f"quotes that do not end: {error}") from error
    if not words:
        return None
    found = _LINE.match(line)
    if found is None:
        raise RequestError(GatewayError.SYNTAX, "no [sequence] at the beginning")
    words = _split(found[2])
    numbers: list[int | None] = []
    while words and words[0].isdecimal() and len(numbers) < 2:
        numbers.append(_number(words.pop(0), 10))
    if not words:
        raise RequestError(GatewayError.SYNTAX, "no command")
    command = words[0].lower()
    if len(numbers) == 1:  # the node, or of commands that are for none the net
        numbers = [*numbers, None] if command == "set" or "lss_" in command else [None, *numbers]
    net, node = numbers or (None, None)
    return Request(_sequence(found[1]), net, node, [command, *words[1:]])


def _number(word: str, base: int, most: int = _MOST) -> int:
    """A number up to `most`; `base` 0: as it is written. Raises RequestError."""
    try:
        value = int(word, base)
    except ValueError:  # also of one of more digits than Python reads
        raise RequestError(GatewayError.SYNTAX, f"'{word[:40]}', expected a number") from None
    if not 0 <= value <= most:
        raise RequestError(GatewayError.SYNTAX, f"{word[:40]}, expected 0 to {most}")
    return value


def _sequence(text: str) -> int:
    return int(text, 16) if text[:2].lower() == "0x" else int(text)


def _split(text: str) -> list[str]:
    lexer = shlex.shlex(text, posix=True, punctuation_chars=False)
    lexer.whitespace_split, lexer.commenters, lexer.quotes, lexer.escape = True, "#", '"', ""
    return list(lexer)


@dataclass(frozen=True)
class TextForm:
    """Text format of the values of a data type, of `width` bytes where that is fixed; `problem`: what a text that is
    none of them is called in messages."""

    to_bytes: Callable[[str], bytes]
    to_text: Callable[[bytes], str]
    width: int | None = None
    problem: str = "'{:.40}' is no value of this data type"

    def parse(self, text: str) -> bytes:
        """Bytes of a value. Raises RequestError."""
        try:
            return self.to_bytes(text)
        except (ValueError, OverflowError) as error:
            raise RequestError(GatewayError.SYNTAX, self.problem.format(text)) from error

    def show(self, data: bytes) -> str:
        """Text of a value. Raises RequestError for bytes of another length."""
        if self.width not in (None, len(data)):
            raise RequestError("0x06070010", f"{len(data)} bytes, expected {self.width} of this data type")
        return self.to_text(data)


def form(name: str) -> TextForm:
    """Text format of a data type by its name. Raises RequestError for a name that is none."""
    try:
        return _FORMS[name.lower()]
    except KeyError:
        raise RequestError(GatewayError.SYNTAX, f"data type '{name}', expected one of {', '.join(_FORMS)}") from None


def _encoded(kind: DataType, text: str) -> bytes:
    value = float(text) if kind.is_float else int(text, 0)
    if kind.is_float and isinf(value) and "inf" not in text.lower():
        raise OverflowError
    return kind.encode(value)


def _time_in(text: str) -> bytes:
    """Days and milliseconds of the day: `ms days`, 28 of 32 bits and 16 bits."""
    days, milliseconds = map(int, text.split())
    if milliseconds >= 1 << 28:
        raise OverflowError
    return milliseconds.to_bytes(4, "little") + days.to_bytes(2, "little")


def _show_time(data: bytes) -> str:
    milliseconds = int.from_bytes(data[:4], "little") & 0x0FFF_FFFF
    return f"{int.from_bytes(data[4:], 'little')} {milliseconds}"


def _show_text(data: bytes) -> str:
    text = data.decode("latin-1").rstrip("\0").replace('"', '""')
    return f'"{text}"' if not text or any(c.isspace() or c == '"' for c in text) else text


def _number_form(kind: DataType, shown: Callable[[Value], str] = str) -> TextForm:
    return TextForm(partial(_encoded, kind), lambda data: shown(kind.decode(data)), kind.width)


_BASE64 = TextForm(
    partial(base64.b64decode, validate=True),
    lambda data: base64.b64encode(data).decode("ascii"),
    problem="'{:.40}', expected base64 (RFC 2045)",
)
_TIME = TextForm(_time_in, _show_time, 6, "'{:.40}', expected days and milliseconds")
_BITS: Final = (8, 16, 32, 64)
#: By the names of CiA 309-3; x… and hex are CANopenNode's.
_FORMS = {
    "b": _number_form(DataType.BOOLEAN, lambda value: str(int(value != 0))),
    **{f"i{bits}": _number_form(DataType[f"INTEGER{bits}"]) for bits in _BITS},
    **{f"u{bits}": _number_form(DataType[f"UNSIGNED{bits}"]) for bits in _BITS},
    **{f"x{bits}": _number_form(DataType[f"UNSIGNED{bits}"], f"0x{{:0{bits // 4}X}}".format) for bits in _BITS},
    "r32": _number_form(DataType.REAL32), "r64": _number_form(DataType.REAL64),
    "t": _TIME, "td": _TIME,
    "vs": TextForm(lambda text: text.encode("latin-1", errors="replace"), _show_text),
    "os": _BASE64, "us": _BASE64, "d": _BASE64,
    "hex": TextForm(bytes.fromhex, lambda data: data.hex(" ").upper(), problem="'{}', expected hexadecimal bytes"),
}  # fmt: skip
