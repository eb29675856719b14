"""Several axes on one node (CiA 301, 7.5.2.1, and CiA 402): places of the objects and the PDOs of each.

A device of several logical devices has the objects of number n at 6000h + (n-1)·800h, and marks that by FFFFh in the
upper half of 1000h; each has its own type at the end of its area, 67FFh + (n-1)·800h. The PDOs of axis
n begin with number 1 + (n-1)·64. All else is the node's: NMT state, heartbeat, SYNC, EMCY, 1001h, 1003h.
Manufacturer-specific objects follow no rule.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from hilbench.canopen.identifiers import RPDO_INDICES, RPDOS, TPDO_INDICES, TPDOS
from hilbench.cia402 import objects

if TYPE_CHECKING:
    from hilbench.canopen.device import Device
    from hilbench.canopen.object_store import Cell
    from hilbench.canopen.pdo import PdoMap

#: Logical devices of a node.
MOST_AXES: Final = 8
#: In the upper half of 1000h: there are several.
SEVERAL: Final = 0xFFFF
_OBJECTS, _PDOS = 0x800, 64
_PROFILE: Final = range(0x6000, 0xA000)
_OF_FIRST: Final = range(0x6000, 0x6800)
_TPDOS_OF_AXIS: Final = 2


def objects_behind(axis: int) -> int:
    """Offset of the object indices of an axis (from 1) from those of the first axis."""
    return _OBJECTS * (axis - 1)


def object_of(axis: int, index: int) -> int:
    """Index of a profile object on an axis, given that of the first axis; others are unchanged."""
    return index + objects_behind(axis) if index in _OF_FIRST else index


def of_first_axis(index: int) -> int:
    """Index on the first axis of an axis's object: 6040h for 6840h."""
    return _PROFILE[(index - _PROFILE.start) % _OBJECTS] if index in _PROFILE else index


def axis_of(index: int) -> int:
    """Axis of an object; 1 for one that belongs to no axis."""
    return 1 + (index - _PROFILE.start) // _OBJECTS if index in _PROFILE else 1


def is_of(axis: int, index: int) -> bool:
    """True if an object is one of an axis, or of the whole node."""
    return object_of(axis, of_first_axis(index)) == index


def axes(has: Callable[[int], bool]) -> list[int]:
    """The axes of a device that are drives: each has a controlword and a statusword."""
    words = (objects.CONTROLWORD, objects.STATUSWORD)
    return [axis for axis in range(1, MOST_AXES + 1) if all(has(object_of(axis, word)) for word in words)]


def rpdo_identifier(node_id: int, axis: int) -> int:
    """COB-ID of an axis' RPDO: the predefined connection set has four of a node."""
    return RPDOS[axis - 1] + node_id


def tpdo_identifiers(node_id: int, axis: int) -> list[int]:
    """COB-IDs of its two TPDOs: the predefined connection set has four of a node, for two axes."""
    first = _TPDOS_OF_AXIS * (axis - 1)
    return [base + node_id for base in TPDOS[first : first + _TPDOS_OF_AXIS]]


def pdo_places(axis: int) -> list[tuple[int, int]]:
    """Communication parameters of an axis's RPDO, then of its two TPDOs: of each its own, and those with its default
    identifier, for devices without PDOs from 65 on."""
    behind, first = _PDOS * (axis - 1), _TPDOS_OF_AXIS * (axis - 1)
    tpdos = [(TPDO_INDICES[k + behind], TPDO_INDICES[k + first]) for k in range(_TPDOS_OF_AXIS)]
    return [(RPDO_INDICES[behind], RPDO_INDICES[axis - 1]), *tpdos]


def mapped_objects(pdo: PdoMap) -> tuple[int, ...]:
    """Objects in a PDO, each by its index on the first axis."""
    return tuple(of_first_axis(variable.index) for variable in pdo.variables)


def emergency_axis(data: bytes) -> int:
    """The axis of which our simulated drives send this EMCY message; 0: it does not say."""
    return data[7] if len(data) == 8 and data[:2] != b"\0\0" else 0


class AxisDevice:
    """One axis of a device: objects of the profile by the names of the first axis, errors of its own."""

    def __init__(self, device: Device, axis: int) -> None:
        self.axis = axis
        self._device = device

    def cell(self, index: int, sub: int = 0) -> Cell:
        """Cell of an object. Raises KeyError when the EDS lacks it."""
        return self._device.cell(object_of(self.axis, index), sub)

    def has(self, index: int, sub: int = 0) -> bool:
        """True if the EDS has the object for this axis."""
        return self._device.has(object_of(self.axis, index), sub)

    def emergency(self, code: int, register_bits: int) -> None:
        """An error of this axis has come: EMCY is the node's, and says it of each axis; of one of several which, in the
        last of the manufacturer's bytes (`emergency_axis`)."""
        several = self.axis > 1 or self._device.has(object_of(2, objects.CONTROLWORD))
        self._device.emergency(code, register_bits, bytes([0, 0, 0, 0, self.axis if several else 0]), self._source)

    def clear_emergency(self, code: int) -> None:
        """Clear an error of this axis."""
        self._device.clear_emergency(code, self._source)

    def keep_emergency(self, code: int) -> None:
        """Keep an EMCY error (`Device.keep_emergency`): this axis is in fault because of it."""
        self._device.keep_emergency(code, self.axis)

    def acknowledge_emergency(self, code: int) -> None:
        """Acknowledge an EMCY error (`Device.acknowledge_emergency`): this axis has left fault."""
        self._device.acknowledge_emergency(code, self.axis)

    @property
    def _source(self) -> int:
        return 1 - self.axis  # unique: nodes and PDOs count from 1


def also(before: Callable[..., Any] | None, then: Callable[..., None]) -> Callable[..., None]:
    """Callback that calls that of one axis, and then that of the next."""
    if before is None:
        return then

    def both(*arguments: Any) -> None:
        before(*arguments)
        then(*arguments)

    return both
