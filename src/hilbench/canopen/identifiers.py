"""Identifiers, NMT commands and NMT states of CANopen (CiA 301): the one table of them.

Function codes are those of the predefined connection set (tables 38 and 39): the COB-ID of node n is code + n.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

#: Broadcast objects: the whole COB-ID.
NMT: Final = 0x000
SYNC: Final = 0x080

EMERGENCY: Final = 0x080
TPDOS: Final = (0x180, 0x280, 0x380, 0x480)
RPDOS: Final = (0x200, 0x300, 0x400, 0x500)
SDO_ANSWER: Final = 0x580
SDO_REQUEST: Final = 0x600
HEARTBEAT: Final = 0x700

#: Layer setting services (CiA 305): the whole COB-ID, of a master's requests and of the answers.
LSS_REQUEST: Final = 0x7E5
LSS_ANSWER: Final = 0x7E4

#: Parts of an 11-bit COB-ID.
FUNCTION_CODE: Final = 0x780
NODE_ID: Final = 0x07F
COB_ID: Final = 0x7FF
LAST_NODE: Final = 127

#: From a PDO's communication parameters to its mapping parameters: 1600h for 1400h, 1A00h for 1800h.
MAPPING: Final = 0x200
#: Indices of the communication parameters of RPDOs and of TPDOs.
RPDO_INDICES: Final = range(0x1400, 0x1600)
TPDO_INDICES: Final = range(0x1800, 0x1A00)

#: Bits in addition to the COB-ID in 1014h and in PDO parameters: not in use; no RTR allowed on a TPDO.
INVALID: Final = 0x8000_0000
NO_REMOTE_REQUEST: Final = 0x4000_0000
#: Bit of 1005h: the device produces SYNC.
PRODUCE_SYNC: Final = 0x4000_0000

#: 29-bit identifiers and the frame bit: this runtime speaks 11-bit identifiers only.
_RESERVED_BITS: Final = 0x3FFF_F800


class NmtCommand(IntEnum):
    """NMT commands (table 34 ff.): the first byte of the frame."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130

    def to(self, node_id: int) -> bytes:
        """The data of the command to one node, or to all (0)."""
        return bytes((self, node_id))


class NmtState(IntEnum):
    """NMT states by the value that a heartbeat carries; INITIALISING is the boot-up message."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127

    @property
    def heartbeat(self) -> bytes:
        """Data of the heartbeat with this state."""
        return bytes((self,))


def pdo_name(index: int) -> str:
    """Name of the PDO whose communication parameters are at an index, by its number at its device: ``TPDO65``; "" for
    another object."""
    for kind, indices in (("RPDO", RPDO_INDICES), ("TPDO", TPDO_INDICES)):
        if index in indices:
            return f"{kind}{indices.index(index) + 1}"
    return ""


def node_of(can_id: int, function: int) -> int:
    """Node id of a message with this function code; 0: it has another one."""
    return can_id - function if function < can_id <= function + LAST_NODE else 0


def is_restricted(cob_id: int) -> bool:
    """True if an object other than NMT, SDO, heartbeat, SYNC and TIME must not take this COB-ID (table 40)."""
    identifier = cob_id & COB_ID
    return (
        bool(cob_id & _RESERVED_BITS)
        or identifier <= 0x080
        or 0x101 <= identifier <= 0x180
        or 0x581 <= identifier <= 0x5FF
        or 0x601 <= identifier <= 0x67F
        or 0x6E0 <= identifier <= 0x6FF
        or identifier >= 0x701
    )
