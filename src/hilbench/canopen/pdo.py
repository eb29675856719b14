"""PDO layouts: the objects in a PDO, and the codec that follows from their types."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any

from canopen.objectdictionary import ODVariable

import canopen
from hilbench.canopen import eds
from hilbench.canopen.data_types import data_type
from hilbench.canopen.identifiers import pdo_name

#: Transmission types (CiA 301, table of 1400h/1800h sub 2).
EVENT_DRIVEN_TYPES = (254, 255)


def mapping_value(variable: ODVariable) -> int:
    """The entry of a mapping object for a variable: index, sub-index, length in bits."""
    return variable.index << 16 | variable.subindex << 8 | bit_length(variable)


def bit_length(variable: ODVariable) -> int:
    """Length of a mapped variable in bits. Raises ValueError for types that can't be mapped here."""
    kind = data_type(variable.data_type or 0)
    if kind.pdo_bits is None:
        raise ValueError(
            f"{variable.index:04X}h sub {variable.subindex} ('{variable.name}') has data type "
            f"{variable.data_type:04X}h, expected a BOOLEAN, an integer of 8 to 64 bits, a REAL or a time"
        )
    return kind.pdo_bits


def received_by(variable: ODVariable) -> bool:
    """True if its access lets it be mapped into an RPDO."""
    return variable.access_type in ("rw", "rww", "wo")


def sent_by(variable: ODVariable) -> bool:
    """True if its access lets it be mapped into a TPDO: rww is a process output (CiA 306), read back by SDO only."""
    return variable.access_type not in ("wo", "rww")


class PdoMap:
    """One PDO: its COB-ID, transmission type and mapped variables in order; `communication`: index of its communication
    parameters (1400h for RPDO1), 0 where it is of no device.

    `pack(values)` and `unpack(data)` translate between the values and the frame's data (`size` bytes), little
    endian as CiA 301 has it; unpack raises struct.error for data of another size. Raises ValueError when the
    variables take more than 8 bytes or can't be mapped.
    """

    def __init__(
        self, cob_id: int, transmission_type: int, variables: Sequence[ODVariable], communication: int = 0
    ) -> None:
        self._bits = [bit_length(variable) for variable in variables]
        size = (sum(self._bits) + 7) // 8
        if size > 8:
            raise ValueError(f"PDO {cob_id:03X}h maps {size} bytes, expected at most 8")
        kinds = [data_type(variable.data_type or 0) for variable in variables]
        self.cob_id = cob_id
        self.transmission_type = transmission_type
        self.communication = communication
        self.variables = tuple(variables)
        self.size = size
        self._layout = struct.Struct("<" + "".join(kind.letter or f"{kind.width}s" for kind in kinds))
        self.kinds = tuple(kinds)
        #: BOOLEAN (one bit, CiA 301, 7.4.7) and integers of 24, 40, 48 and 56 bits: struct does not know them.
        self._odd = any(not kind.letter for kind in kinds)
        self.unpack: Callable[[bytes], tuple[Any, ...]] = self._unpack_bits if self._odd else self._layout.unpack

    @classmethod
    def from_names(
        cls,
        od: canopen.ObjectDictionary,
        cob_id: int,
        transmission_type: int,
        names: Sequence[int | str],
        communication: int = 0,
    ) -> PdoMap:
        """A map of objects looked up in the dictionary by `eds.find`.

        Raises KeyError for an object that the dictionary lacks, ValueError for one that cannot be mapped.
        """
        variables = [eds.find(od, name) for name in names]
        for variable in variables:
            if not variable.pdo_mappable:
                raise ValueError(f"{variable.index:04X}h ('{variable.name}') is not mappable by its EDS")
        return cls(cob_id, transmission_type, variables, communication)

    def pack(self, values: Sequence[int | float]) -> bytes:
        """The frame's data. Raises ValueError for a value that does not fit its object."""
        try:
            return self._pack_bits(values) if self._odd else self._layout.pack(*values)
        except (struct.error, OverflowError) as error:
            names = ", ".join(variable.name for variable in self.variables)
            raise ValueError(f"PDO {self.cob_id:03X}h ({names}) cannot carry {tuple(values)}: {error}") from error

    def _unpack_bits(self, data: bytes) -> tuple[Any, ...]:
        if len(data) != self.size:
            raise struct.error(f"{len(data)} bytes for PDO {self.cob_id:03X}h, expected {self.size}")
        values, rest = [], int.from_bytes(data, "little")
        for kind, bits in zip(self.kinds, self._bits, strict=True):
            values.append(kind.decode((rest & ((1 << bits) - 1)).to_bytes(kind.width or 0, "little")))
            rest >>= bits
        return tuple(values)

    def _pack_bits(self, values: Sequence[int | float]) -> bytes:
        packed, at = 0, 0
        for kind, bits, value in zip(self.kinds, self._bits, values, strict=True):
            number = int.from_bytes(kind.encode(value), "little")
            if number >> bits:
                raise OverflowError(f"{value} takes more than {bits} bit")
            packed |= number << at
            at += bits
        return packed.to_bytes(self.size, "little")

    @property
    def name(self) -> str:
        """Name by its number at its device: ``TPDO65``."""
        return pdo_name(self.communication)

    @property
    def mapping(self) -> list[int]:
        """The entries of its mapping object."""
        return [mapping_value(variable) for variable in self.variables]

    @property
    def period(self) -> int:
        """Period in SYNCs; 0 for a PDO that is not cyclic."""
        return self.transmission_type if 1 <= self.transmission_type <= 240 else 0
