"""Values of a device: one cell per object, the single store for SDO, PDO and application."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from canopen.objectdictionary import ODVariable

import canopen
from canopen import SdoAbortedError
from hilbench.canopen import eds
from hilbench.canopen.data_types import data_type

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
GENERAL_ERROR = 0x08000000
TOGGLE = 0x05030000
UNKNOWN_COMMAND = 0x05040001
BLOCK_SIZE = 0x05040002
SEQUENCE_NUMBER = 0x05040003
CRC_ERROR = 0x05040004
CANNOT_STORE = 0x08000020
PRESENT_STATE = 0x08000022

Value = Any


class SdoAbort(SdoAbortedError):  # noqa: N818 - the service of CiA 301, not an error of ours
    """Refuses a write; `code` is the abort code of CiA 301."""


class Cell:
    """The value of one object. `on_write` is called with a new value before it is taken, by SDO and RPDO."""

    __slots__ = ("_start", "_type", "on_read", "on_write", "value", "variable")

    def __init__(self, variable: ODVariable) -> None:
        self.variable = variable
        self._type = data_type(variable.data_type or 0)
        self._start: Value = self._type.neutral
        self.value: Value = self.initial()
        self.on_write: Callable[[Value], None] | None = None
        self.on_read: Callable[[], Value] | None = None

    def initial(self) -> Value:
        """The value after a reset: the DCF's ParameterValue, the EDS' default, the application's, or zero."""
        for value in (self.variable.value, self.variable.default):
            if value is not None:
                return value
        return self._start

    def start_with(self, value: Value) -> None:
        """Set the application's start value of an object without a default in the EDS file, and its value."""
        self._start = value
        self.value = self.initial()

    @property
    def width(self) -> int | None:
        """Bytes of its SDO data; None: as many as there are."""
        return self._type.width

    def encode(self) -> bytes:
        """Encode the value as SDO data. Raises ValueError for a value that is none of the object's type."""
        return self._type.encode(self.on_read() if self.on_read is not None else self.value)

    def decode(self, data: bytes) -> Value:
        """The value in SDO data. Raises SdoAbort for a wrong length."""
        self.check_length(len(data))
        return self._type.decode(data)

    def check_length(self, length: int) -> None:
        """Raise SdoAbort when so many bytes are no value of the object."""
        width = self._type.width
        if width is not None and length != width:
            raise SdoAbort(TOO_LONG if length > width else TOO_SHORT)

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

    def conditional(self, index: int, code: int, default: Value) -> Cell:
        """Cell of an object that a device may lack (CiA 301): without it the default counts, and it is not accessible
        on the bus."""
        if (index, 0) in self:
            return self.cell(index)
        variable = ODVariable(f"{index:04X}h", index)
        variable.data_type, variable.default = code, default
        return Cell(variable)

    def requested(self, index: int, sub: int) -> Cell:
        """The cell that a request names. Raises SdoAbort when there is none."""
        cell = self._cells.get((index, sub))
        if cell is None:
            raise SdoAbort(NO_SUB_INDEX if index >= 0x1000 and index in self.od else NO_OBJECT)
        return cell

    def reset(self, first: int, last: int) -> None:
        """Set all objects with first <= index <= last to their values after a reset."""
        for (index, _), cell in self._cells.items():
            if first <= index <= last:
                cell.value = cell.initial()
