"""PDO layouts: which objects a PDO carries, and the codec that follows from their types."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import canopen
from canopen import objectdictionary as types
from canopen.objectdictionary import ODVariable

from hilbench.fieldbus import eds

#: struct characters of the types that the codec carries; sub-byte and odd-width types are refused.
STRUCT_CODES: dict[int | None, str] = {
    types.BOOLEAN: "?",
    types.INTEGER8: "b",
    types.INTEGER16: "h",
    types.INTEGER32: "i",
    types.INTEGER64: "q",
    types.UNSIGNED8: "B",
    types.UNSIGNED16: "H",
    types.UNSIGNED32: "I",
    types.UNSIGNED64: "Q",
    types.REAL32: "f",
    types.REAL64: "d",
}

#: Transmission types (CiA 301, table of 1400h/1800h sub 2).
EVENT_DRIVEN_TYPES = (254, 255)


def mapping_value(variable: ODVariable) -> int:
    """The entry of a mapping object for a variable: index, sub-index, length in bits."""
    return variable.index << 16 | variable.subindex << 8 | bit_length(variable)


def bit_length(variable: ODVariable) -> int:
    """Length of a mapped variable in bits; a BOOLEAN takes a byte. Raises ValueError for types that can't be mapped."""
    code = STRUCT_CODES.get(variable.data_type)
    if code is None:
        raise ValueError(
            f"{variable.index:04X}h sub {variable.subindex} ('{variable.name}') has data type "
            f"{variable.data_type:04X}h, expected an integer of 8 to 64 bits or a REAL"
        )
    return 8 * struct.calcsize("<" + code)


class PdoMap:
    """One PDO: its COB-ID, transmission type and mapped variables in order.

    `pack(values)` and `unpack(data)` translate between the values and the frame's data (`size` bytes), little
    endian as CiA 301 has it. Raises ValueError when the variables take more than 8 bytes or can't be mapped.
    """

    def __init__(self, cob_id: int, transmission_type: int, variables: Sequence[ODVariable]) -> None:
        for variable in variables:
            bit_length(variable)
        layout = struct.Struct("<" + "".join(STRUCT_CODES[variable.data_type] for variable in variables))
        if layout.size > 8:
            raise ValueError(f"PDO {cob_id:03X}h maps {layout.size} bytes, expected at most 8")
        self.cob_id = cob_id
        self.transmission_type = transmission_type
        self.variables = tuple(variables)
        self.size = layout.size
        self.unpack = layout.unpack
        self._layout = layout

    @classmethod
    def from_names(
        cls, od: canopen.ObjectDictionary, cob_id: int, transmission_type: int, names: Sequence[int | str]
    ) -> PdoMap:
        """A map of objects looked up in the dictionary by `eds.find`.

        Raises KeyError for an object that the dictionary lacks, ValueError for one that cannot be mapped.
        """
        variables = [eds.find(od, name) for name in names]
        for variable in variables:
            if not variable.pdo_mappable:
                raise ValueError(f"{variable.index:04X}h ('{variable.name}') is not mappable by its EDS")
        return cls(cob_id, transmission_type, variables)

    def pack(self, values: Sequence[int | float]) -> bytes:
        """The frame's data. Raises struct.error for a value that does not fit its object."""
        return self._layout.pack(*values)

    @property
    def mapping(self) -> list[int]:
        """The entries of its mapping object."""
        return [mapping_value(variable) for variable in self.variables]

    @property
    def period(self) -> int:
        """Sent every so many SYNCs; 0 for a PDO that is not cyclic."""
        return self.transmission_type if 1 <= self.transmission_type <= 240 else 0
