"""The drives over a bus: canopen's own CiA-402 client, unchanged, and the set-up by our master."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from canopen.profiles.p402 import BaseNode402
from tests.buses import Bus
from tests.cia402.stand_in import CYCLE_S, EDS, SimulatedDrives, served

from canopen import Network
from hilbench.can.frame import Frame
from hilbench.can.link import Link
from hilbench.canopen.clock import MonotonicClock
from hilbench.canopen.device import Device
from hilbench.canopen.eds import load_eds
from hilbench.canopen.identifiers import NmtCommand
from hilbench.canopen.master import Master
from hilbench.cia402.configuration import DriveSettings, RpdoCopy
from hilbench.cia402.drive import Drive, DriveGoal
from hilbench.cia402.objects import OperationMode
from hilbench.cia402.state_machine import State
from hilbench.errors import BenchFaultError, UnusableInputError

RPM = 10_000


@contextmanager
def hosted(bus: Bus, *node_ids: int) -> Iterator[SimulatedDrives]:
    """Drives on the bus (node 1 unless said), served by a thread."""
    clock = MonotonicClock(stall_s=1.0)
    devices = [Device(load_eds(EDS, node_id), node_id, clock) for node_id in node_ids or (1,)]
    application = SimulatedDrives(devices)
    with served(bus.open_link(), devices, clock, application):
        yield application


@contextmanager
def mastered(bus: Bus, *node_ids: int) -> Iterator[Master]:
    """Our master, knowing these nodes (1 unless said) as axis 1, axis 2 and so on."""
    master = Master(bus.open_python_can(), sdo_timeout_s=5.0)
    try:
        for number, node_id in enumerate(node_ids or (1,), 1):
            master.add(node_id, load_eds(EDS, node_id), f"axis {number}")
        yield master
    finally:
        master.close()


def eventually(condition: Callable[[], bool], timeout_s: float = 5.0) -> None:
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


@pytest.fixture
def client(bus: Bus) -> Iterator[BaseNode402]:
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


def csv(name: str, node_id: int, **changes: object) -> Drive:
    mode = OperationMode.CYCLIC_SYNCHRONOUS_VELOCITY
    return Drive(DriveSettings(name, node_id, mode, CYCLE_S, **changes), load_eds(EDS, node_id))  # type: ignore[arg-type]


def run_cycles(link: Link, drive: Drive, count: int) -> None:
    """SYNC, all TPDOs, decode, RPDO."""
    expected = {pdo.cob_id for pdo in drive.pdos.tpdos}
    for _ in range(count):
        link.send([Frame(0x80, b"")])
        frames: dict[int, bytes] = {}
        deadline_s = time.monotonic() + 5.0
        while not expected <= frames.keys() and time.monotonic() < deadline_s:
            frames.update({frame.can_id: frame.data for frame in link.receive(0.01)})
        drive.decode(frames)
        link.send(drive.encode())


def test_a_drive_whose_60c2_is_constant_is_configured_by_what_it_has(
    bus: Bus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    head, exponent, rest = EDS.read_text().partition("[60C2sub2]")
    file = tmp_path / "constant.eds"
    file.write_text(head + exponent + rest.replace("AccessType=rw", "AccessType=const", 1))
    monkeypatch.setattr(sys.modules[__name__], "EDS", file)
    with hosted(bus), mastered(bus) as master:
        csv("axis 1", 1).configure(master)
        assert (master.sdo_read(1, 0x60C2, 1), master.sdo_read(1, 0x60C2, 2)) == (2, -3)


def test_pdos_of_the_makers_file_that_no_axis_takes_are_switched_off(
    bus: Bus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "four_pdos.eds"
    valid = EDS.read_text().replace("$NODEID+0x80000", "$NODEID+0x").replace("$NODEID+0xC0000", "$NODEID+0x40000")
    file.write_text(valid)
    monkeypatch.setattr(sys.modules[__name__], "EDS", file)
    with hosted(bus), mastered(bus) as master:
        assert master.sdo_read(1, 0x1802, 1) == 0x40000381
        csv("axis 1", 1).configure(master)
        cob_ids = {
            index: int(master.sdo_read(1, index, 1)) for index in (*range(0x1400, 0x1404), *range(0x1800, 0x1804))
        }
    assert [index for index, cob_id in cob_ids.items() if not cob_id & 1 << 31] == [0x1400, 0x1800, 0x1801]


def test_our_master_configures_and_drives_it(bus: Bus) -> None:
    with hosted(bus), mastered(bus) as master:
        drive = csv("axis 1", 1, parameters={(0x605A, 0): 6, (0x6076, 0): 2500})
        drive.configure(master)
        assert drive.units.torque_Nm == pytest.approx(0.0025)
        assert master.sdo_read(1, 0x605A) == 6
        assert (master.sdo_read(1, 0x60C2, 1), master.sdo_read(1, 0x60C2, 2)) == (2, -3)
        link = bus.open_link()
        master.nmt(NmtCommand.START)
        drive.request(DriveGoal.ENABLED)
        drive.setpoint = 20.0
        run_cycles(link, drive, 100)
        assert drive.feedback.state is State.OPERATION_ENABLED
        assert drive.feedback.velocity_rad_s == pytest.approx(20.0, rel=1e-3)
        link.close()


@pytest.mark.parametrize("way", ["listen", "copy"])
def test_a_virtual_axis_hears_the_same_commands(bus: Bus, way: str) -> None:
    with hosted(bus, 1, 17) as plant, mastered(bus, 1, 17) as master:
        axis = csv("axis 1", 1, copies=(RpdoCopy(0x211),) if way == "copy" else ())
        virtual = csv("virtual axis 1", 17, listens_to=0x201 if way == "listen" else None, tpdo_type=None)
        for drive in (axis, virtual):
            drive.configure(master)
        link = bus.open_link()
        master.nmt(NmtCommand.START)
        axis.request(DriveGoal.ENABLED)
        axis.setpoint = 20.0
        run_cycles(link, axis, 60)
        real, mirror = (motor.port for motor in plant.motors)
        assert mirror.velocity_rad_s == pytest.approx(20.0, rel=1e-3)
        assert mirror.setpoint == real.setpoint
        axis.request(DriveGoal.COAST)
        run_cycles(link, axis, 4)
        assert [drive.state for drive in plant.drives] == [State.SWITCH_ON_DISABLED] * 2
        link.close()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"identity": (0, 0x999)}, r"axis 1 \(node 1\): product code \(1018h:2\) is 00000402h, expected 00000999h"),
        ({"parameters": {(0x605A, 0): 99}}, r"axis 1 \(node 1\).*605Ah"),
    ],
)
def test_what_the_device_refuses_is_named(bus: Bus, changes: dict[str, object], message: str) -> None:
    with hosted(bus), mastered(bus) as master, pytest.raises(BenchFaultError, match=message):
        csv("axis 1", 1, **changes).configure(master)


def test_parameters_that_the_eds_lacks_are_unusable_input(bus: Bus) -> None:
    with hosted(bus), mastered(bus) as master, pytest.raises(UnusableInputError, match="axis 1: the EDS lacks 6099h:1"):
        csv("axis 1", 1, parameters={(0x6099, 1): 5}).configure(master)
