"""Fault confinement: bus off of a CAN controller with too many errors (ISO 11898-1, 12.1.4).

The emulated wire counts for each of its stations; a station receives a change of its state as in SocketCAN, by
an error message frame (Linux, include/uapi/linux/can/error.h).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from hilbench.can.frame import ERROR_FLAG
from hilbench.errors import BusError

#: Error counters from which a controller is error passive, and bus off.
PASSIVE_FROM, OFF_FROM = 128, 256
#: What a broken-off attempt costs its transmitter.
_TRANSMIT_FAILED = 8
#: Error classes, and the bits of data[1] of the class "controller".
_CONTROLLER, _BUS_OFF, _RESTARTED, _COUNTERS = 0x004, 0x040, 0x100, 0x200
_RECEIVE_PASSIVE, _TRANSMIT_PASSIVE, _ACTIVE = 0x10, 0x20, 0x40

#: Error classes that a socket subscribes to for its controller's state.
STATE_CLASSES = _CONTROLLER | _BUS_OFF | _RESTARTED


class ControllerState(Enum):
    """A controller's part on the bus: whole; without dominant error flags; none at all until it is restarted."""

    ERROR_ACTIVE = "error active"
    ERROR_PASSIVE = "error passive"
    BUS_OFF = "bus off"


@dataclass(slots=True)
class ErrorCounters:
    """TEC and REC of one controller, by the rules that matter for frames broken off on the wire."""

    transmit: int = 0
    receive: int = 0

    @property
    def state(self) -> ControllerState:
        """Controller state by the counters."""
        if self.transmit >= OFF_FROM:
            return ControllerState.BUS_OFF
        passive = self.transmit >= PASSIVE_FROM or self.receive >= PASSIVE_FROM
        return ControllerState.ERROR_PASSIVE if passive else ControllerState.ERROR_ACTIVE

    @property
    def clear(self) -> bool:
        """True if both counters are 0."""
        return not (self.transmit or self.receive)

    def count(self, *, own: bool, failed: bool) -> None:
        """Count a frame on the wire, the controller's `own` or another's, that was over, or broken off."""
        if own:
            self.transmit = self.transmit + _TRANSMIT_FAILED if failed else max(0, self.transmit - 1)
        else:
            self.receive = (
                min(self.receive + 1, PASSIVE_FROM) if failed else max(0, min(self.receive, PASSIVE_FROM) - 1)
            )

    def message(self) -> tuple[int, bytes]:
        """Identifier and data of the error message frame that carries this state."""
        state = self.state
        if state is ControllerState.BUS_OFF:
            return ERROR_FLAG | _BUS_OFF | _COUNTERS, bytes(6) + bytes((255, min(self.receive, 255)))
        if state is ControllerState.ERROR_PASSIVE:
            bits = (self.transmit >= PASSIVE_FROM) * _TRANSMIT_PASSIVE | (
                self.receive >= PASSIVE_FROM
            ) * _RECEIVE_PASSIVE
        else:
            bits = _ACTIVE
        data = bytes((0, bits, 0, 0, 0, 0, min(self.transmit, 255), min(self.receive, 255)))
        return ERROR_FLAG | _CONTROLLER | _COUNTERS, data


def state_in_message(can_id: int, data: bytes) -> ControllerState | None:
    """The controller's state that an error message frame carries; None for one of something else."""
    if can_id & _BUS_OFF:
        return ControllerState.BUS_OFF
    if can_id & _RESTARTED:
        return ControllerState.ERROR_ACTIVE
    if can_id & _CONTROLLER and len(data) > 1:
        if data[1] & (_RECEIVE_PASSIVE | _TRANSMIT_PASSIVE):
            return ControllerState.ERROR_PASSIVE
        if data[1] & _ACTIVE:
            return ControllerState.ERROR_ACTIVE
    return None


def bus_off(place: str) -> BusError:
    """The error for a connection whose controller has left the bus."""
    return BusError(f"{place}: our controller is bus off (too many transmit errors: cable, termination, bit rate?)")
