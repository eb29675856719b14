"""Slave side of the layer setting services (CiA 305): identity, node id and bit rate of a device.

It answers with or without a node id; the host decides about the effect of a new one.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final

from hilbench.can.frame import Frame
from hilbench.canopen.identifiers import LAST_NODE, LSS_ANSWER

#: The node id of a device that has none.
UNCONFIGURED: Final = 255

#: Bit rates of table 0 by index (CiA 305, table 1); 5 is reserved, 9 is automatic detection.
BIT_RATES: Final = {
    0: 1_000_000, 1: 800_000, 2: 500_000, 3: 250_000, 4: 125_000, 6: 50_000, 7: 20_000, 8: 10_000,
}  # fmt: skip

# Command specifiers, the first byte of each frame.
_SWITCH_GLOBAL, _CONFIGURE_NODE_ID, _CONFIGURE_BIT_RATE, _STORE = 0x04, 0x11, 0x13, 0x17
_SELECT_VENDOR, _SELECT_SERIAL, _SELECTED = 0x40, 0x43, 0x44
_IDENTIFY_VENDOR, _IDENTIFY_LAST, _IDENTIFY_UNCONFIGURED = 0x46, 0x4B, 0x4C
_IDENTIFIED, _UNCONFIGURED_IDENTIFIED, _FAST_SCAN = 0x4F, 0x50, 0x51
_INQUIRE_VENDOR, _INQUIRE_SERIAL, _INQUIRE_NODE_ID = 0x5A, 0x5D, 0x5E

_SCAN: Final = struct.Struct("<xIBBB")
_START_OF_SCAN: Final = 128
_DONE, _REFUSED = 0, 1


class LssState(Enum):
    """LSS states: services that change the device reach it in CONFIGURATION only."""

    WAITING = 0
    CONFIGURATION = 1


@dataclass(frozen=True)
class LssSettings:
    """Settings kept over a loss of power."""

    node_id: int
    bit_rate: int | None = None  #: bit/s; None: never given


class LssSlave:
    """Handles LSS requests of one device. `identity`: 1018h sub 1 to 4, the LSS address.

    `node_id` is the one in force; `pending` what a reset of the communication (or, without a node id, leaving the
    configuration state) puts in force, which is the host's to do by `take_effect`.
    """

    def __init__(self, identity: Sequence[int], node_id: int) -> None:
        if len(identity) != 4:
            raise ValueError(f"{len(identity)} numbers, expected vendor, product code, revision and serial number")
        self.identity = tuple(identity)
        self.state = LssState.WAITING
        self.node_id = node_id
        self.pending = LssSettings(node_id)
        self.stored: LssSettings | None = None
        self._matched = 0  # parts of the address that a selective switch has named rightly so far
        self._in_range = 0  # the same for identification
        self._scanned = 0  # the part of the address that a fast scan is at

    def take_effect(self) -> bool:
        """Put the pending node id in force. True when it is another one than before."""
        changed = self.pending.node_id != self.node_id
        self.node_id = self.pending.node_id
        return changed

    def handle(self, data: bytes) -> Frame | None:
        """The answer to a request, if there is one. Frames of another length than eight bytes are no LSS."""
        if len(data) != 8:
            return None
        command = data[0]
        answer: bytes | None
        if command == _SWITCH_GLOBAL:
            if data[1] in (LssState.WAITING.value, LssState.CONFIGURATION.value):
                self.state = LssState(data[1])
            return None
        if _SELECT_VENDOR <= command <= _SELECT_SERIAL:
            answer = self._select(command - _SELECT_VENDOR, _number(data))
        elif _IDENTIFY_VENDOR <= command <= _IDENTIFY_LAST:
            answer = self._identify(command - _IDENTIFY_VENDOR, _number(data))
        elif command == _IDENTIFY_UNCONFIGURED:
            answer = bytes([_UNCONFIGURED_IDENTIFIED]) if self._is_unconfigured else None
        elif command == _FAST_SCAN:
            answer = self._fast_scan(*_SCAN.unpack(data))
        else:
            answer = self._in_configuration(data) if self.state is LssState.CONFIGURATION else None
        return None if answer is None else Frame(LSS_ANSWER, answer.ljust(8, b"\0"))

    @property
    def _is_unconfigured(self) -> bool:
        return self.pending.node_id == UNCONFIGURED

    def _select(self, part: int, number: int) -> bytes | None:
        if part == 0:
            self._matched = 0
        if self.state is LssState.CONFIGURATION or part != self._matched or number != self.identity[part]:
            self._matched = 0
            return None
        self._matched += 1
        if part < 3:
            return None
        self._matched = 0
        self.state = LssState.CONFIGURATION
        return bytes([_SELECTED])

    def _identify(self, step: int, number: int) -> bytes | None:
        """Vendor, product, then lowest and highest revision, lowest and highest serial number."""
        if step == 0:
            self._in_range = 0
        vendor, product, revision, serial = self.identity
        fits = (
            number == vendor, number == product, number <= revision, revision <= number, number <= serial,
            serial <= number,
        )[step]  # fmt: skip
        self._in_range = self._in_range + 1 if fits and step == self._in_range else 0
        return bytes([_IDENTIFIED]) if self._in_range == 6 else None

    def _fast_scan(self, number: int, bit: int, part: int, following: int) -> bytes | None:
        """Only devices without node id that wait take part (CiA 305, fastscan)."""
        if not self._is_unconfigured or self.state is LssState.CONFIGURATION:
            return None
        if bit == _START_OF_SCAN:
            self._scanned = 0
            return bytes([_IDENTIFIED])
        if part > 3 or bit > 31 or part != self._scanned or number >> bit != self.identity[part] >> bit:
            return None
        if bit == 0:
            if following < part:  # the last part is right: this device is the one
                self.state = LssState.CONFIGURATION
            self._scanned = following
        return bytes([_IDENTIFIED])

    def _in_configuration(self, data: bytes) -> bytes | None:
        command = data[0]
        if command == _CONFIGURE_NODE_ID:
            return bytes([command, self._configure_node_id(data[1])])
        if command == _CONFIGURE_BIT_RATE:
            return bytes([command, self._configure_bit_rate(data[1], data[2])])
        if command == _STORE:
            self.stored = self.pending
            return bytes([command, _DONE])
        if _INQUIRE_VENDOR <= command <= _INQUIRE_SERIAL:
            return struct.pack("<BI", command, self.identity[command - _INQUIRE_VENDOR])
        if command == _INQUIRE_NODE_ID:
            return bytes([command, self.node_id])
        return None  # activating a bit rate is not answered; anything else is none of the services

    def _configure_node_id(self, node_id: int) -> int:
        if not 1 <= node_id <= LAST_NODE and node_id != UNCONFIGURED:
            return _REFUSED
        self.pending = LssSettings(node_id, self.pending.bit_rate)
        return _DONE

    def _configure_bit_rate(self, table: int, index: int) -> int:
        if table != 0 or index not in BIT_RATES:
            return _REFUSED
        self.pending = LssSettings(self.pending.node_id, BIT_RATES[index])
        return _DONE


def _number(data: bytes) -> int:
    return int.from_bytes(data[1:5], "little")
