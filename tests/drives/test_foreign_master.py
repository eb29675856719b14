"""The drives over a bus: canopen's own CiA-402 client, unchanged, and the set-up by our master."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
from canopen import Network
from canopen.profiles.p402 import BaseNode402
from tests.drives.stand_in import CYCLE_S, EDS, FirstOrderMotor

from hilbench.bus.frame import Frame
from hilbench.bus.memory import MemoryBus
from hilbench.drives.configuration import DriveSettings
from hilbench.drives.drive import Drive, DriveGoal
from hilbench.drives.objects import OperationMode
from hilbench.drives.port import MotorPort
from hilbench.drives.simulated import SimulatedDrive
from hilbench.drives.state_machine import State
from hilbench.errors import BenchFaultError
from hilbench.fieldbus.clock import MonotonicClock
from hilbench.fieldbus.device import Device
from hilbench.fieldbus.eds import load_eds
from hilbench.fieldbus.host import DeviceHost
from hilbench.fieldbus.master import START, Master

RPM = 10_000


class OneDrive:
    """Host application: one simulated drive and its motor."""

    def __init__(self, device: Device) -> None:
        port = MotorPort()
        self.motor = FirstOrderMotor(port)
        self.drive = SimulatedDrive(device, port)

    def before_sync(self) -> None:
        pass

    def after_sync(self) -> None:
        self.tick(CYCLE_S)

    def tick(self, duration_s: float) -> None:
        self.drive.sync(duration_s)
        self.motor.advance(duration_s)
        self.drive.publish()

    def on_frame(self, frame: Frame) -> None:
        pass


@contextmanager
def hosted(bus: MemoryBus) -> Iterator[OneDrive]:
    """A drive as node 1 on the bus, served by a thread."""
    clock = MonotonicClock()
    device = Device(load_eds(EDS, 1), 1, clock)
    application = OneDrive(device)
    link = bus.open_link()
    host = DeviceHost(link, [device], clock, application)
    stop = threading.Event()
    thread = threading.Thread(target=host.run, args=(stop.is_set,))
    thread.start()
    try:
        yield application
    finally:
        stop.set()
        thread.join()
        link.close()


def eventually(condition: Callable[[], bool], timeout_s: float = 5.0) -> None:
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


@pytest.fixture
def client() -> Iterator[BaseNode402]:
    bus = MemoryBus()
    with hosted(bus):
        network = Network(bus.open_python_can())
        network.connect()
        node = BaseNode402(1, load_eds(EDS, 1))
        network.add_node(node)
        node.nmt.state = "PRE-OPERATIONAL"
        node.sdo.RESPONSE_TIMEOUT = 2.0
        try:
            yield node
        finally:
            network.sync.stop()
            network.disconnect()


MODES = [("CYCLIC SYNCHRONOUS VELOCITY", 9), ("PROFILED VELOCITY", 3), ("CYCLIC SYNCHRONOUS TORQUE", 10)]


@pytest.mark.parametrize(("mode", "code"), MODES, ids=["CSV", "PV", "CST"])
def test_canopens_client_drives_it_by_pdo(client: BaseNode402, mode: str, code: int) -> None:
    client.sdo[0x6083].raw = 20_000 * RPM
    client.sdo[0x6060].raw = code
    client.setup_402_state_machine()
    target = client.rpdo[1]
    if code == 10:
        client.rpdo[1].clear()
        client.rpdo[1].add_variable(0x6040)
        client.rpdo[1].add_variable(0x6071)
        client.rpdo[1].save()
        client.setup_402_state_machine()
    client.nmt.state = "OPERATIONAL"
    target.start(CYCLE_S)
    client.network.sync.start(CYCLE_S)
    client.op_mode = mode
    assert client.op_mode == mode
    client.state = "OPERATION ENABLED"
    assert client.state == "OPERATION ENABLED"
    if code == 10:
        target[0x6071].raw = 20
        eventually(lambda: client.sdo[0x6077].raw == 20)
        assert client.sdo[0x606C].raw > 0
        target[0x6071].raw = 0
    else:
        target[0x60FF].raw = 300 * RPM
        eventually(lambda: client.sdo[0x606C].raw == pytest.approx(300 * RPM, rel=1e-2))
        target[0x60FF].raw = 0
    client.state = "SWITCHED ON"
    client.state = "READY TO SWITCH ON"
    client.state = "SWITCH ON DISABLED"
    assert client.state == "SWITCH ON DISABLED"
    target.stop()


def test_canopens_client_drives_it_by_sdo_before_nmt_start(client: BaseNode402) -> None:
    client.sdo[0x6060].raw = 9
    for controlword, status in ((0x06, 0x231), (0x07, 0x233), (0x0F, 0x237)):
        client.sdo[0x6040].raw = controlword
        assert client.sdo[0x6041].raw & 0x27F == status
    client.sdo[0x60FF].raw = 100 * RPM
    eventually(lambda: client.sdo[0x606C].raw == pytest.approx(100 * RPM, rel=1e-2))
    client.sdo[0x6040].raw = 0x00
    assert client.sdo[0x6041].raw & 0x27F == 0x250


def test_canopens_client_homes_and_resets_a_fault(client: BaseNode402) -> None:
    client.setup_402_state_machine()
    client.nmt.state = "OPERATIONAL"
    client.rpdo[1].start(CYCLE_S)
    client.network.sync.start(CYCLE_S)
    client.sdo[0x607C].raw = 4711
    assert client.homing(timeout=2)
    assert client.sdo[0x6064].raw == 4711
    client.sdo[0x2001].raw = 0x7300
    eventually(lambda: client.is_faulted())
    client.reset_from_fault()
    assert client.state == "OPERATION ENABLED"
    client.rpdo[1].stop()


def test_our_master_configures_and_drives_it() -> None:
    bus = MemoryBus()
    with hosted(bus):
        master = Master(bus.open_python_can(), sdo_timeout_s=5.0)
        od = load_eds(EDS, 1)
        master.add(1, od, "axis 1")
        mode = OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY
        settings = DriveSettings("axis 1", 1, mode, CYCLE_S, parameters={(0x605A, 0): 6, (0x6076, 0): 2500})
        drive = Drive(settings, od)
        try:
            drive.configure(master)
            assert drive.units.torque_Nm == pytest.approx(0.0025)
            assert master.sdo_read(1, 0x605A) == 6
            assert (master.sdo_read(1, 0x60C2, 1), master.sdo_read(1, 0x60C2, 2)) == (2, -3)
            link = bus.open_link()
            master.nmt(START)
            drive.request(DriveGoal.ENABLED)
            drive.setpoint = 20.0
            for _ in range(300):
                _cycle(link, drive)
            assert drive.feedback.state is State.OPERATION_ENABLED
            assert drive.feedback.velocity_rad_s == pytest.approx(20.0, rel=1e-3)
            link.close()
        finally:
            master.close()


def _cycle(link, drive: Drive) -> None:  # type: ignore[no-untyped-def]
    link.send([Frame(0x80, b"")])
    frames: dict[int, bytes] = {}
    deadline_s = time.monotonic() + 5.0
    while not {0x181, 0x281} <= frames.keys() and time.monotonic() < deadline_s:
        frames.update({frame.can_id: frame.data for frame in link.receive(0.01)})
    drive.decode(frames)
    link.send(drive.encode())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"identity": (0, 0x999)}, r"axis 1 \(node 1\): product code \(1018h:2\) is 00000402h, expected 00000999h"),
        ({"parameters": {(0x605A, 0): 99}}, r"axis 1 \(node 1\).*605Ah"),
    ],
)
def test_what_the_device_refuses_is_named(changes: dict[str, object], message: str) -> None:
    bus = MemoryBus()
    with hosted(bus):
        master = Master(bus.open_python_can(), sdo_timeout_s=5.0)
        od = load_eds(EDS, 1)
        master.add(1, od, "axis 1")
        mode = OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY
        try:
            with pytest.raises(BenchFaultError, match=message):
                Drive(DriveSettings("axis 1", 1, mode, CYCLE_S, **changes), od).configure(master)  # type: ignore[arg-type]
        finally:
            master.close()
