"""A simulated drive with its parts, and its node id where a master gives it one (LSS, CiA 305)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from hilbench.apps.devices.behaviour import Behaviour
from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.canopen.device import Device
from hilbench.canopen.identifiers import COB_ID, LSS_REQUEST, NMT, NmtCommand
from hilbench.canopen.lss_slave import UNCONFIGURED, LssSlave, LssState
from hilbench.cia402.axis import AxisDevice
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.simulated import SimulatedDrive as Cia402Drive
from hilbench.cia402.simulated import supported_modes
from hilbench.cia402.units import DriveUnits
from hilbench.plant.motor_port import MotorPort
from hilbench.plant.servo_axis.shaft import ServoRig

#: Index and sub-index.
SERIAL_NUMBER: Final = (0x1018, 4)

_IDENTITY: Final = ((0x1018, 1), (0x1018, 2), (0x1018, 3), SERIAL_NUMBER)
_RESETS: Final = (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION)
_POLL_S: Final = 0.01


@dataclass(frozen=True)
class SimulatedNode:
    """One drive as it was made: a node, or one of its axes."""

    device: Device
    drive: Cia402Drive
    port: MotorPort
    rig: ServoRig
    units: DriveUnits
    behaviour: Behaviour
    #: Assumptions about what the EDS file does not contain; one line each.
    assumptions: Sequence[str]
    name: str
    axis: int = 1

    @property
    def modes(self) -> list[OperationMode]:
        """Modes of operation that it has."""
        supported = supported_modes(AxisDevice(self.device, self.axis))
        return [mode for mode in OperationMode if mode and supported & mode.supported_bit]


def lss_address(device: Device) -> list[int]:
    """Vendor-ID, product code, revision and serial number; 0 for what the EDS file lacks (CiA 305)."""
    return [int(device.cell(*place).value) if device.has(*place) else 0 for place in _IDENTITY]


def await_node_id(link: Link, lss: LssSlave, stop: Callable[[], bool]) -> None:
    """Without a node id only LSS is answered, until a master has given one and has left the configuration state."""
    link.set_filters([(LSS_REQUEST, COB_ID)])
    while not stop():
        for frame in link.receive(_POLL_S):
            answer = lss.handle(frame.data) if frame.can_id == LSS_REQUEST else None
            if answer is not None:
                link.send([answer])
        if lss.state is LssState.WAITING and lss.pending.node_id != UNCONFIGURED:
            lss.take_effect()
            return


class NodeIdGiven:
    """LSS slave of a device on the bus; a reset puts the node id in force that it was given."""

    listens_to: Final = frozenset({LSS_REQUEST, NMT})

    def __init__(self, lss: LssSlave, device: Device) -> None:
        self._lss, self._device = lss, device
        #: The device has to be made anew, with the node id of the slave.
        self.takes_effect = False

    def on_frame(self, frame: Frame) -> None:
        """Handle an LSS request, or an NMT reset."""
        if frame.can_id == LSS_REQUEST:
            answer = self._lss.handle(frame.data)
            if answer is not None:
                self._device.outbox.append(answer)
        elif len(frame.data) == 2 and frame.data[0] in _RESETS and frame.data[1] in (0, self._device.node_id):
            self.takes_effect = self._lss.take_effect()
            if self.takes_effect:
                self._device.replies.clear()  # its boot-up: it is the new node that boots
