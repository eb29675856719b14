"""Simulated drives on their host: their parts, shafts that turn, scheduled events, and node ids by LSS (CiA 305)."""

from __future__ import annotations

import queue
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import pi
from typing import Final

from hilbench.apps.devices.behaviour import Behaviour, Event
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
from hilbench.hardware.plant_time import ByClock
from hilbench.hardware.simulation import RigApplication
from hilbench.plant.motor_port import MotorMode, MotorPort
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


#: Sample time of the drives' control loops, and how often they look at their set points at least.
SAMPLE_S: Final = 0.001
CYCLE_S: Final = 0.002


class DrivesApplication(RigApplication):
    """The `Application` of a host: each drive on a shaft of its own, all by one clock, whatever the period of SYNC.

    Other threads act on the drives by `ask`: what they ask for is done between two cycles, by the host's thread.
    """

    def __init__(self, nodes: Sequence[SimulatedNode], now_ns: Callable[[], int]) -> None:
        self.faulty = [FaultyDrive(node, now_ns) for node in nodes]  #: for what goes wrong with each of them
        self._lss: NodeIdGiven | None = None
        self._asked: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        time = ByClock(CYCLE_S, SAMPLE_S, now_ns, lambda _text: None, any_period=True)
        super().__init__([node.drive for node in nodes], [node.port for node in nodes], self, time, CYCLE_S)

    def ask(self, what: Callable[[], None]) -> None:
        """Do this soon; may be called from any thread."""
        self._asked.put(what)

    def before_sync(self, behind: int) -> None:
        """Advance by the clock."""
        self._happen()
        super().before_sync(behind)

    def tick(self, duration_s: float) -> None:
        """No SYNC runs: time goes on all the same."""
        self._happen()
        super().tick(duration_s)

    def step(self, duration_s: float) -> None:
        """Turn all shafts for so long."""
        for drive in self.faulty:
            drive.step(duration_s)

    def put_beside(self, lss: NodeIdGiven) -> None:
        """Add an LSS slave that receives its own frames for the node."""
        self._lss, self.listens_to = lss, lss.listens_to

    def on_frame(self, frame: Frame) -> None:
        """A frame of LSS, or one for all; others don't concern a drive."""
        if self._lss is not None:
            self._lss.on_frame(frame)

    def _happen(self) -> None:
        while not self._asked.empty():
            self._asked.get()()
        for drive in self.faulty:
            drive.happen()


class FaultyDrive:
    """A drive's own events, and what a test does to it."""

    def __init__(self, node: SimulatedNode, now_ns: Callable[[], int]) -> None:
        self._node = node
        self._now_ns = now_ns
        self._power_on_ns = now_ns()
        own = (event for event in node.behaviour.events if event.axis == node.axis)
        self._events = sorted(own, key=lambda event: event.at_s)
        self._jumped_rad = 0.0
        self._in_use = False
        #: When heartbeats, and everything, are sent again.
        self._no_heartbeat_until_ns = self._silent_until_ns = 0

    def step(self, duration_s: float) -> None:
        """Turn the shaft, once the drive has had power; the encoder shows it with its jumps."""
        self._in_use = self._in_use or self._node.port.mode is not MotorMode.OFF
        if not self._in_use:  # of a hundred drives on a bus most rest
            return
        self._node.rig.lock_to(duration_s)
        self._node.rig.step(duration_s)
        self._node.port.position_rad += self._jumped_rad

    def happen(self) -> None:
        """Cause the events that are due."""
        now_ns = self._now_ns()
        while self._events and (now_ns - self._power_on_ns) * 1e-9 >= self._events[0].at_s:
            self.cause(self._events.pop(0))
        if self._node.axis > 1:
            return  # what the node sends is the first axis' to fail
        device = self._node.device
        device.silent = now_ns < self._silent_until_ns
        device.heartbeat_fails = now_ns < self._no_heartbeat_until_ns

    def cause(self, event: Event) -> None:
        """Cause an event now."""
        device, now_ns = self._node.device, self._now_ns()
        if event.fault is not None:
            self._node.drive.fault(event.fault)
        elif event.emergency is not None:
            raised = event.emergency
            device.emergency(raised.code, raised.register_bits, bytes(raised.data))
        elif event.emergency_over is not None:
            device.clear_emergency(event.emergency_over)
        elif event.encoder_jump_turns is not None:
            self._jumped_rad += event.encoder_jump_turns * 2.0 * pi
            self._node.port.position_rad += event.encoder_jump_turns * 2.0 * pi
        elif event.no_heartbeat_s is not None:
            self._no_heartbeat_until_ns = now_ns + round(event.no_heartbeat_s * 1e9)
        elif event.silent_s is not None:
            self._silent_until_ns = now_ns + round(event.silent_s * 1e9)
        elif event.reset:
            device.reset_node()
