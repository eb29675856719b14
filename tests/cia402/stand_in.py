"""A drive in a test: its device, a first-order motor behind its port, and cycles of 2 ms."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import count
from math import copysign, inf, pi
from pathlib import Path

import canopen
from hilbench.apps.devices.behaviour import Behaviour
from hilbench.apps.devices.drive import SimulatedDrive as DriveOnABus
from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.can.python_can import can
from hilbench.canopen.clock import Clock
from hilbench.canopen.device import Device
from hilbench.canopen.eds import load_eds
from hilbench.canopen.host import Application, DeviceHost
from hilbench.cia402.simulated import SimulatedDrive
from hilbench.cia402.switches import Switches
from hilbench.plant.motor_port import MotorMode, MotorPort

EDS = Path(__file__).parents[2] / "eds" / "hilbench_servo.eds"
CYCLE_S = 0.002


class FirstOrderMotor:
    """A motor whose velocity and torque follow the loop's reference at once but for a time constant."""

    def __init__(self, port: MotorPort, inertia_kg_m2: float = 0.01, lag_s: float = 0.001) -> None:
        self.port = port
        self.inertia_kg_m2 = inertia_kg_m2
        self.lag_s = lag_s
        self.blocked = False
        self._mode = MotorMode.OFF

    def advance(self, dt_s: float) -> None:
        port = self.port
        if port.mode is not self._mode:
            self._mode = port.mode
            port.reference = {MotorMode.VELOCITY: port.velocity_rad_s, MotorMode.POSITION: port.position_rad}.get(
                port.mode, 0.0
            )
        if port.mode is MotorMode.OFF:
            port.torque_Nm, port.torque_limited = 0.0, False
            self._move(port.velocity_rad_s, dt_s)
            return
        before = port.reference
        difference = port.setpoint - before
        step = port.slope * dt_s if port.slope < inf else inf
        # The last step lands on the set point exactly.
        port.reference = port.setpoint if abs(difference) <= step + 1e-12 else before + copysign(step, difference)
        torque = self._torque(before, dt_s)
        limit = port.torque_limit_Nm
        port.torque_limited = abs(torque) > limit
        port.torque_Nm = max(-limit, min(limit, torque))
        self._move(port.velocity_rad_s + port.torque_Nm / self.inertia_kg_m2 * dt_s, dt_s)

    def _torque(self, before: float, dt_s: float) -> float:
        port = self.port
        if port.mode is MotorMode.TORQUE:
            return port.reference
        wanted = port.reference
        if port.mode is MotorMode.POSITION:
            wanted = (port.reference - port.position_rad) / dt_s
        return (wanted - port.velocity_rad_s) * self.inertia_kg_m2 / max(dt_s, self.lag_s)

    def _move(self, velocity_rad_s: float, dt_s: float) -> None:
        port = self.port
        port.velocity_rad_s = 0.0 if self.blocked else velocity_rad_s
        port.position_rad += port.velocity_rad_s * dt_s


class StandingClock:
    """No timer of the device runs."""

    def now_ns(self) -> int:
        return 0

    def tick(self) -> None:
        pass

    def stalled_ns(self) -> int:
        return 0


class DriveUnderTest:
    """The simulated drive with its motor; objects are written as by SDO."""

    def __init__(self, eds: Path = EDS, *, switches: Switches | None = None) -> None:
        self.device = Device(load_eds(eds, 1), 1, StandingClock())
        self.port = MotorPort()
        self.motor = FirstOrderMotor(self.port)
        self.drive = SimulatedDrive(self.device, self.port, switches=switches)
        self.device.boot()
        self.device.outbox.clear()

    def write(self, index: int, value: int, sub: int = 0) -> None:
        self.device.cell(index, sub).write(value)

    def read(self, index: int, sub: int = 0) -> int:
        return int(self.device.cell(index, sub).value)

    def cycle(self, count: int = 1) -> None:
        for _ in range(count):
            self.drive.sync(CYCLE_S)
            self.motor.advance(CYCLE_S)
            self.drive.publish()

    def controlword(self, value: int, cycles: int = 1) -> int:
        """Write a controlword, run some cycles; the statusword after them."""
        self.write(0x6040, value)
        self.cycle(cycles)
        return self.read(0x6041)

    def enable(self, mode: int) -> None:
        self.write(0x6060, mode)
        for value in (0x06, 0x07, 0x0F):
            self.controlword(value)

    def slope_rpm_s(self) -> float | None:
        """Ramp that the firmware asks of the velocity loop; None: as fast as it can."""
        assert self.port.mode is MotorMode.VELOCITY
        assert self.port.setpoint == 0.0
        return None if self.port.slope == inf else self.port.slope * 60.0 / (2.0 * pi)

    def emergency_codes(self) -> list[int]:
        """Error codes of the EMCY messages so far."""
        return [int.from_bytes(f.data[:2], "little") for f in self.device.outbox if f.can_id == 0x81]

    def lose_master(self, nmt: bool) -> None:
        """The master is heard no more, or (`nmt`) takes the device out of OPERATIONAL."""
        self.device.handle(Frame(0, bytes([1, 0])))
        if nmt:
            self.device.handle(Frame(0, bytes([128, 0])))
        else:
            assert self.device.on_communication_error is not None
            self.device.on_communication_error(0x8130)


class SimulatedDrives:
    """Host application: simulated drives and their motors."""

    listens_to: frozenset[int] = frozenset()

    def __init__(self, devices: list[Device]) -> None:
        ports = [MotorPort() for _ in devices]
        self.motors = [FirstOrderMotor(port) for port in ports]
        self.drives = [SimulatedDrive(device, port) for device, port in zip(devices, ports, strict=True)]

    def before_sync(self, behind: int) -> None:
        pass

    def after_sync(self) -> None:
        self.tick(CYCLE_S)

    def tick(self, duration_s: float) -> None:
        for drive, motor in zip(self.drives, self.motors, strict=True):
            drive.sync(duration_s)
            motor.advance(duration_s)
            drive.publish()

    def on_frame(self, frame: Frame) -> None:
        pass


@contextmanager
def served(link: Link, devices: Sequence[Device], clock: Clock, application: Application) -> Iterator[None]:
    """The devices on the link, served by a thread; the link is closed at the end."""
    stop = threading.Event()
    thread = threading.Thread(target=DeviceHost(link, devices, clock, application).run, args=(stop.is_set,))
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        link.close()


def eventually(condition: Callable[[], bool], timeout_s: float = 10.0) -> None:
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


@contextmanager
def on_a_virtual_bus(
    eds: Path, node: canopen.RemoteNode, behaviour: Behaviour | Path | None = None
) -> Iterator[tuple[DriveOnABus, str]]:
    """A simulated drive on a bus of python-can beside canopen's client that drives it; the bus' channel."""
    channel = f"drives-{next(_channels)}"
    with (
        can.Bus(interface="virtual", channel=channel) as ours,
        DriveOnABus(eds, node.id, can.Bus(interface="virtual", channel=channel), behaviour=behaviour) as drive,
    ):
        network = canopen.Network(ours)
        network.connect()
        network.add_node(node)
        node.sdo.RESPONSE_TIMEOUT = 2.0
        eventually(lambda: answers(node))
        try:
            yield drive, channel
        finally:
            network.disconnect()


def answers(node: canopen.RemoteNode) -> bool:
    """False while it boots."""
    try:
        return node.sdo[0x1000].raw is not None
    except (canopen.SdoCommunicationError, canopen.SdoAbortedError):
        return False


def enable(node: canopen.RemoteNode, mode: int, offset: int = 0) -> None:
    """An axis, whose objects lie so far behind those of the first."""
    node.sdo[0x6060 + offset].raw = mode
    for word in (0x80, 0x06, 0x07, 0x0F):
        node.sdo[0x6040 + offset].raw = word
    eventually(lambda: node.sdo[0x6041 + offset].raw & 0x6F == 0x27)


_channels = count()
