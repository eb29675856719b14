"""Description of the device by its EDS file, for cases."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from hilbench.canopen.data_types import DataType, data_type
from hilbench.canopen.eds import all_variables, load_eds, object_flags
from hilbench.cia402.axis import axes, object_of

if TYPE_CHECKING:
    from canopen.objectdictionary import ODVariable

#: ObjFlags (CiA 306): refuse write on download, refuse read on scan.
REFUSE_WRITE, REFUSE_READ = 0x1, 0x2
_WRITABLE: Final = ("rw", "rwr", "rww")
_DUMMIES: Final = 0x1000


@dataclass(frozen=True)
class Entry:
    """One value of the device as its EDS file has it."""

    variable: ODVariable
    index: int
    sub: int
    access: str  #: ro, const, wo, rw, rwr or rww
    kind: DataType
    flags: int

    @classmethod
    def of(cls, v: ODVariable, flags: int) -> Entry:
        """Entry of a value in an object dictionary."""
        return cls(v, v.index, v.subindex, v.access_type, data_type(v.data_type or 0), flags)

    @property
    def key(self) -> tuple[int, int]:
        return self.index, self.sub

    @property
    def writable(self) -> bool:
        """True if it can be read and written."""
        return self.access in _WRITABLE

    @property
    def readable(self) -> bool:
        return self.access != "wo"

    @property
    def constant(self) -> bool:
        """Writes are to be refused."""
        return self.access in ("ro", "const")

    @property
    def default(self) -> bytes | None:
        """SDO data of its default, or of the value that a DCF gives it; None where the file has neither, or one that
        its data type can't have (letters beyond ASCII in a VISIBLE_STRING)."""
        value = self.variable.default if self.variable.value is None else self.variable.value
        try:
            return None if value is None else self.kind.encode(value)
        except ValueError:
            return None

    def beyond(self, limit: Literal["min", "max"]) -> int | None:
        """The first integer beyond a limit of the file; None where it has none, or where the data type ends there."""
        at = getattr(self.variable, limit)
        value = None if at is None else int(at) + (1 if limit == "max" else -1)
        try:
            if value is not None:
                self.kind.encode(value)
        except ValueError:
            return None
        return value

    @property
    def mapping(self) -> int:
        """Entry of the object in a PDO mapping."""
        bits = self.kind.pdo_bits or 0
        return self.index << 16 | self.sub << 8 | bits

    def __str__(self) -> str:
        return f"{self.index:04X}h:{self.sub} '{self.variable.name}'"


@dataclass(frozen=True)
class Pdo:
    """One PDO of the device: index of its communication parameters, COB-ID, the object that it carries."""

    index: int
    cob_id: int
    carries: Entry

    @property
    def size(self) -> int:
        """Bytes of its data."""
        return self.carries.kind.width or 1


class Description:
    """An EDS file, for the device with this node id. Raises UnusableInputError for a file that can't be used."""

    def __init__(self, path: Path, node_id: int) -> None:
        self.path = path
        self.od = load_eds(path, node_id)
        flags = object_flags(path)
        found = [Entry.of(v, flags.get((v.index, v.subindex), 0)) for v in all_variables(self.od)]
        self._entries = {entry.key: entry for entry in found}
        self.dummies = [index for index in self.od.indices if index < _DUMMIES]
        #: The drives of the node, and which of them cases are about: what they name is its own then.
        self.axes = axes(self.od.__contains__)
        self.axis = 1

    def each_axis(self) -> Iterator[int]:
        """One after the other (the device itself where it is no drive), each in force while it is there."""
        try:
            for axis in self.axes or [1]:
                self.axis = axis
                yield axis
        finally:
            self.axis = 1

    def own(self, index: int) -> int:
        """Index of an object on this axis, named as that of the first one."""
        return object_of(self.axis, index)

    def has(self, index: int, sub: int = 0) -> bool:
        """True if the file has the value."""
        return (self.own(index), sub) in self._entries

    def entry(self, index: int, sub: int = 0) -> Entry:
        """Raises KeyError for one that is not in the file."""
        return self._entries[self.own(index), sub]

    def can_write(self, index: int, sub: int = 0) -> bool:
        """True if the file has the value, to be read and written."""
        return self.has(index, sub) and self.entry(index, sub).writable

    def entries(self, first: int = 0x1000, last: int = 0x9FFF) -> Iterator[Entry]:
        """Entries of an area; of each object sub-index 0 last, as a configuration writes them."""
        found = [entry for entry in self._entries.values() if first <= entry.index <= last]
        yield from sorted(found, key=lambda entry: (entry.index, entry.sub == 0, entry.sub))

    def pdos(self, communication: int) -> list[int]:
        """Numbers (from 0) of the PDOs of 1400h or 1800h."""
        return [number for number in range(512) if self.has(communication + number, 1)]

    @property
    def is_drive(self) -> bool:
        """CiA 402: controlword and statusword."""
        return self.axis in self.axes
