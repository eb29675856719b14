"""The simulated hardware: the drives of the bench on their test stand, a process of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hilbench.bench.config import BenchConfig, NodeConfig
from hilbench.bench.nodes import declared_units
from hilbench.bench.processes import say, stop_request
from hilbench.bench.twin_setup import device_clock
from hilbench.bus.frame import Frame
from hilbench.bus.open import open_link
from hilbench.drives.port import MotorMode, MotorPort
from hilbench.drives.simulated import SimulatedDrive
from hilbench.fieldbus.device import Device
from hilbench.fieldbus.eds import load_eds
from hilbench.fieldbus.host import DeviceHost, HostedDevices
from hilbench.fieldbus.object_store import INVALID_VALUE, SdoAbort
from hilbench.real_time import kept_ready
from hilbench.web.effect_objects import bind_effect_objects
from hilbench.web.stand import TestStand


class StandApplication:
    """What the hardware does at a SYNC: the drives take their set points, then the stand moves on by one cycle."""

    listens_to: frozenset[int] = frozenset()

    def __init__(
        self, drives: list[SimulatedDrive], ports: Sequence[MotorPort], stand: TestStand, cycle_s: float
    ) -> None:
        self._drives = drives
        self._ports = ports
        self._in_use = False
        self._stand = stand
        self._cycle_s = cycle_s

    def before_sync(self, behind: int) -> None:
        """Nothing to do: the state at this SYNC is there since the last one."""

    def after_sync(self) -> None:
        """Advance to the time of the next SYNC."""
        self.tick(self._cycle_s)

    def tick(self, duration_s: float) -> None:
        """Advance by a time, also when there is no SYNC."""
        for drive in self._drives:
            drive.sync(duration_s)
        # At rest with all power stages off nothing moves; the noise must not depend on how long that lasted.
        if self._in_use or any(port.mode is not MotorMode.OFF for port in self._ports):
            self._in_use = True
            self._stand.advance(duration_s)
        for drive in self._drives:
            drive.publish()

    def on_frame(self, frame: Frame) -> None:
        """Frames for others don't concern the hardware."""


def simulate(config: BenchConfig) -> int | None:
    """Simulate the nodes of the bench that are marked `simulated` until SIGTERM, SIGINT or the end of the bench.

    Returns how many frames were lost because they were not read in time (None: the bus cannot tell).
    """
    stop = stop_request()
    hosted = hardware(config)
    link = open_link(config.bus_address)
    try:
        with kept_ready(config.process_settings("hardware"), say):
            DeviceHost(link, *hosted).run(stop)
    finally:
        link.close()
    return link.dropped


def hardware(config: BenchConfig) -> HostedDevices:
    """The nodes of the bench that are marked `simulated`, on their stand."""
    clock = device_clock(config)
    ports = (MotorPort(), MotorPort(), MotorPort())
    stand_parameters = config.stand_parameters()
    # A scratch stand runs first, so that compiling is over before the devices boot.
    TestStand(stand_parameters, tuple(MotorPort() for _ in ports)).advance(config.cycle_time_s)
    stand = TestStand(stand_parameters, ports, config.seed)
    devices, drives = [], []
    for (part, axis), port in zip((("axis1", 1), ("axis2", 2), ("load", None)), ports, strict=True):
        node: NodeConfig = getattr(config.nodes, part)
        if not node.simulated:
            continue
        od = load_eds(node.eds, node.node_id)
        device = Device(od, node.node_id, clock)
        drives.append(SimulatedDrive(device, port, declared_units(config, part, od)))
        devices.append(device)
        if axis is not None:
            bind_effect_objects(device, _effect_setter(stand, axis))
    return HostedDevices(devices, clock, StandApplication(drives, ports, stand, config.cycle_time_s))


def _effect_setter(stand: TestStand, axis: int) -> Callable[[str, dict[str, float]], None]:
    def apply(effect: str, parameters: dict[str, float]) -> None:
        try:
            stand.set_effect(effect, axis, slot=0, **parameters)
        except ValueError:
            raise SdoAbort(INVALID_VALUE) from None

    return apply
