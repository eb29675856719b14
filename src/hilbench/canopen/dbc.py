"""A DBC file of PDOs, for tools that decode a bus without EDS files: names, places, scale to SI, units.

A DBC file does not say how it is encoded: some tools take it for Windows-1252 (cantools, those of its inventor), others
for UTF-8. What is written here is ASCII, which is the same in both.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from hilbench.canopen.data_types import REAL32, REAL64, DataType, data_type
from hilbench.canopen.pdo import PdoMap, bit_length

_FLOAT_TYPES = {REAL32: 1, REAL64: 2}  # SIG_VALTYPE_ of IEEE floats of 32 and 64 bits
_LONGEST_NAME = 32  # of a symbol in most tools
_UNIT_SIGNS = str.maketrans({"·": "", "²": "^2", "³": "^3", "°": "deg", "µ": "u", "Ω": "Ohm"})


@dataclass(frozen=True)
class DbcMessage:
    """One PDO: who sends it, its map, and for each mapped object what a unit of it is in SI (factor, unit's name)."""

    name: str
    sender: str
    pdo: PdoMap
    units: tuple[tuple[float, str] | None, ...]


def dbc_text(messages: Iterable[DbcMessage], comment: str) -> str:
    """The file. Objects without a unit keep their raw values; raises ValueError for a COB-ID that is there twice."""
    known: dict[int, DbcMessage] = {}
    for message in messages:
        if known.setdefault(message.pdo.cob_id, message) is not message:
            raise ValueError(f"COB-ID {message.pdo.cob_id:X}h of {message.name} and {known[message.pdo.cob_id].name}")
    senders = list(dict.fromkeys(symbol(message.sender) for message in known.values()))
    lines = ['VERSION ""', "", "NS_ :", "", "BS_:", "", f"BU_: {' '.join(senders)}", ""]
    for message in known.values():
        lines += [*_message(message), ""]
    lines.append(f'CM_ "{_quoted(comment)}";')
    lines += [line for message in known.values() for line in _remarks(message)]
    return "\n".join(lines) + "\n"


def symbol(text: str) -> str:
    """A name as DBC allows it."""
    name = re.sub(r"\W+", "_", text, flags=re.ASCII).strip("_") or "_"
    return (name if not name[0].isdigit() else f"_{name}")[:_LONGEST_NAME]


def ascii_unit(unit: str) -> str:
    """A unit as DBC files have it: N·m is Nm, m/s² is m/s^2."""
    return _ascii(unit.translate(_UNIT_SIGNS))


def _ascii(text: str) -> str:
    """Letters without their marks; a question mark for what is none."""
    marked = unicodedata.normalize("NFKD", text)
    plain = "".join(sign for sign in marked if not unicodedata.combining(sign))
    return plain.encode("ascii", "replace").decode()


def _message(message: DbcMessage) -> Iterator[str]:
    yield f"BO_ {message.pdo.cob_id} {symbol(message.name)}: {message.pdo.size} {symbol(message.sender)}"
    start = 0
    for variable, unit in zip(message.pdo.variables, message.units, strict=True):
        bits, kind = bit_length(variable), data_type(variable.data_type or 0)
        factor, name = unit or (1.0, "")
        name = ascii_unit(name)
        sign = "-" if kind.is_signed or kind.is_float else "+"
        low, high = _range(kind, bits, factor)
        yield (
            f' SG_ {symbol(variable.name)} : {start}|{bits}@1{sign} ({factor:.17g},0) [{low:.9g}|{high:.9g}] "{name}" '
            "Vector__XXX"
        )
        start += bits


def _range(kind: DataType, bits: int, factor: float) -> tuple[float, float]:
    if kind.is_float:
        return 0.0, 0.0  # no range
    if kind.is_signed:
        return -(1 << (bits - 1)) * factor, ((1 << (bits - 1)) - 1) * factor
    return 0.0, ((1 << bits) - 1) * factor


def _remarks(message: DbcMessage) -> Iterator[str]:
    for variable in message.pdo.variables:
        place = f"{message.pdo.cob_id} {symbol(variable.name)}"
        yield f'CM_ SG_ {place} "{variable.index:04X}h:{variable.subindex} {_quoted(variable.name)}";'
        if variable.data_type in _FLOAT_TYPES:
            yield f"SIG_VALTYPE_ {place} : {_FLOAT_TYPES[variable.data_type]};"


def _quoted(text: str) -> str:
    return " ".join(_ascii(text.replace('"', "'")).split())
