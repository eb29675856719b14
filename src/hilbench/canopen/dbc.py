"""A DBC file of PDOs, for tools that decode a bus without EDS files: names, places, scale to SI, units.

A DBC file does not state its encoding: some tools take it for Windows-1252 (cantools, those of its inventor), others
for UTF-8. The text written here is ASCII, which is the same in both.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from cantools.database.can import Bus, Database, Message, Node, Signal
from cantools.database.conversion import BaseConversion

from hilbench.canopen.data_types import data_type
from hilbench.canopen.pdo import PdoMap, bit_length

_UNIT_SIGNS = str.maketrans({"·": "", "²": "^2", "³": "^3", "°": "deg", "µ": "u", "Ω": "Ohm"})


@dataclass(frozen=True)
class DbcMessage:
    """One PDO: its sender, its map, and for each mapped object one unit of it in SI (factor, unit's name)."""

    name: str
    sender: str
    pdo: PdoMap
    units: tuple[tuple[float, str] | None, ...]
    names: tuple[str, ...] = ()  #: of the mapped objects, where they have others than in the EDS file


def dbc_text(messages: Iterable[DbcMessage], comment: str) -> str:
    """Text of the file; objects without a unit keep their raw values. Names of more than 32 letters are given in full
    in addition to the short ones (attribute ``SystemSignalLongSymbol``)."""
    known = list(messages)
    senders = dict.fromkeys(symbol(message.sender) for message in known)
    database = Database(
        [
            Message(
                message.pdo.cob_id,
                symbol(message.name),
                message.pdo.size,
                list(_signals(message)),
                senders=[symbol(message.sender)],
                sort_signals=None,
            )
            for message in known
        ],
        [Node(sender) for sender in senders],
        [Bus("", comment=_ascii(comment))],
        version="",
    )
    return database.as_dbc_string(sort_signals=None).replace("\r\n", "\n")


def symbol(text: str) -> str:
    """A name as DBC allows it."""
    name = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_") or "_"
    return name if not name[0].isdigit() else f"_{name}"


def _ascii(text: str) -> str:
    """Letters without their marks; a question mark for what is none."""
    marked = unicodedata.normalize("NFKD", text.replace('"', "'"))
    ascii_text = "".join(sign for sign in marked if not unicodedata.combining(sign))
    return " ".join(ascii_text.encode("ascii", "replace").decode().split())


def _signals(message: DbcMessage) -> Iterator[Signal]:
    start = 0
    names = message.names or [variable.name for variable in message.pdo.variables]
    for variable, unit, called in zip(message.pdo.variables, message.units, names, strict=True):
        bits, kind = bit_length(variable), data_type(variable.data_type or 0)
        factor, name = unit or (1, "")
        lowest, highest = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if kind.is_signed else (0, (1 << bits) - 1)
        yield Signal(
            symbol(called),
            start,
            bits,
            is_signed=kind.is_signed or kind.is_float,
            conversion=BaseConversion.factory(factor, is_float=kind.is_float),
            minimum=None if kind.is_float else _rounded(lowest * factor),
            maximum=None if kind.is_float else _rounded(highest * factor),
            unit=_ascii(name.translate(_UNIT_SIGNS)) or None,
            comment=_ascii(f"{variable.index:04X}h:{variable.subindex} {called}"),
        )
        start += bits


def _rounded(value: float) -> float:
    return value if isinstance(value, int) else float(f"{value:.9g}")
