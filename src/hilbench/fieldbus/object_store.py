"""The values of a device: one cell an object, the single store for SDO, PDO and application."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any

import canopen
from canopen import SdoAbortedError
from canopen import objectdictionary as types
from canopen.objectdictionary import ODVariable

from hilbench.fieldbus import eds
from hilbench.fieldbus.pdo import STRUCT_CODES

#: Abort codes of CiA 301 by what they mean.
UNSUPPORTED_ACCESS = 0x06010000
WRITE_ONLY = 0x06010001
READ_ONLY = 0x06010002
NO_OBJECT = 0x06020000
NOT_MAPPABLE = 0x06040041
PDO_LENGTH = 0x06040042
INCOMPATIBLE = 0x06040043
TOO_LONG = 0x06070012
TOO_SHORT = 0x06070013
NO_SUB_INDEX = 0x06090011
INVALID_VALUE = 0x06090030
VALUE_TOO_HIGH = 0x06090031
VALUE_TOO_LOW = 0x06090032
NO_DATA = 0x08000024
CANNOT_STORE = 0x08000020
PRESENT_STATE = 0x08000022

Value = Any


class SdoAbort(SdoAbortedError):  # noqa: N818 - the service of CiA 301, not an error of ours
    """Refuses a write; `code` is the abort code of CiA 301."""


class Cell:
    """The value of one object. `on_write` is called with a new value before it is taken, by SDO and RPDO."""

    __slots__ = ("_layout", "on_read", "on_write", "value", "variable")

    def __init__(self, variable: ODVariable) -> None:
        code = STRUCT_CODES.get(variable.data_type)
        self.variable = variable
        self._layout = struct.Struct("<" + code) if code else None
        self.value: Value = _initial(variable)
        self.on_write: Callable[[Value], None] | None = None
        self.on_read: Callable[[], Value] | None = None

    def encode(self) -> bytes:
        """The value as it goes over SDO."""
        value = self.on_read() if self.on_read is not None else self.value
        if self._layout is not None:
            return self._layout.pack(value)
        if isinstance(value, str):
            return value.encode("latin-1", "replace")
        return bytes(value)

    def decode(self, data: bytes) -> Value:
        """The value in SDO data. Raises SdoAbort for a wrong length."""
        if self._layout is None:
            return data.decode("latin-1") if self.variable.data_type == types.VISIBLE_STRING else bytes(data)
        if len(data) != self._layout.size:
            raise SdoAbort(TOO_LONG if len(data) > self._layout.size else TOO_SHORT)
        return self._layout.unpack(data)[0]

    def write(self, value: Value) -> None:
        """Take a value from the bus: limits, then `on_write`, then the store. Raises SdoAbort when refused."""
        low, high = self.variable.min, self.variable.max
        if high is not None and value > high:
            raise SdoAbort(VALUE_TOO_HIGH)
        if low is not None and value < low:
            raise SdoAbort(VALUE_TOO_LOW)
        if self.on_write is not None:
            self.on_write(value)
        self.value = value


def _initial(variable: ODVariable) -> Value:
    """The value of a device that was just reset: DCF's ParameterValue, the default, or zero."""
    value = variable.value if variable.value is not None else variable.default
    if variable.data_type in (types.REAL32, types.REAL64):
        return _real(variable, value)
    if variable.data_type in STRUCT_CODES:
        return int(value) if value is not None else 0
    if variable.data_type == types.VISIBLE_STRING:
        return value if value is not None else ""
    return value if isinstance(value, bytes) else b""


def _real(variable: ODVariable, value: Value) -> float:
    """CiA 306 writes REAL defaults as the hexadecimal digits of their IEEE 754 representation."""
    if isinstance(value, int) and value != 0:
        width, code = (4, "<f") if variable.data_type == types.REAL32 else (8, "<d")
        return float(struct.unpack(code, value.to_bytes(width, "little"))[0])
    return float(value or 0.0)


class ObjectStore:
    """All cells of a device by (index, sub-index)."""

    def __init__(self, od: canopen.ObjectDictionary) -> None:
        self.od = od
        self._cells = {(v.index, v.subindex): Cell(v) for v in eds.all_variables(od)}

    def __contains__(self, key: tuple[int, int]) -> bool:
        return key in self._cells

    def __iter__(self) -> Iterator[Cell]:
        return iter(self._cells.values())

    def cell(self, index: int, sub: int = 0) -> Cell:
        """The cell of an object. Raises KeyError when the object dictionary lacks it."""
        try:
            return self._cells[index, sub]
        except KeyError:
            raise KeyError(f"no object {index:04X}h sub {sub} in the EDS") from None

    def requested(self, index: int, sub: int) -> Cell:
        """The cell that a request names. Raises SdoAbort when there is none."""
        cell = self._cells.get((index, sub))
        if cell is None:
            raise SdoAbort(NO_SUB_INDEX if index in self.od else NO_OBJECT)
        return cell

    def reset(self, first: int, last: int) -> None:
        """Set all objects with first <= index <= last to their values after a reset."""
        for (index, _), cell in self._cells.items():
            if first <= index <= last:
                cell.value = _initial(cell.variable)
