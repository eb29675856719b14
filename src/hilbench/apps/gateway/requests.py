"""A line of CiA 309-3's ASCII mapping: `[sequence] [[net] node] command arguments # comment`."""

from __future__ import annotations

import re
import shlex
from dataclasses import dataclass
from typing import Final

from hilbench.apps.gateway.errors import GatewayError, RequestError

_LINE: Final = re.compile(r"^\s*\[\s*([0-9]{1,10}|0x[0-9A-Fa-f]{1,8})\s*\]\s*(.*)$")
_MOST: Final = 0xFFFF_FFFF


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
