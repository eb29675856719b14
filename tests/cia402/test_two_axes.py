"""A node with two axes (CiA 402): canopen's client as the master of a simulated one, and the frames between them."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.cia402.stand_in import StandingClock, enable, eventually, on_a_virtual_bus

import canopen
from hilbench import SimulatedDrive
from hilbench.apps.devices.behaviour import Behaviour
from hilbench.can.frame import Frame
from hilbench.can.python_can import can
from hilbench.canopen.device import Device
from hilbench.canopen.eds import load_eds
from hilbench.cia402.simulated import SimulatedDrive as Cia402Drive
from hilbench.cia402.state_machine import State
from hilbench.errors import UnusableInputError
from hilbench.plant.motor_port import MotorPort

DUAL = Path(__file__).parents[2] / "eds" / "hilbench_servo_dual.eds"
NODE = 5
ENABLED = 0x27
#: A turn a second, in units of 0.0001 rpm.
TURN_PER_S = 600_000


@contextmanager
def driven() -> Iterator[tuple[SimulatedDrive, canopen.RemoteNode, can.BusABC]]:
    """The node, the client that knows its EDS file, and somebody who listens."""
    node = canopen.RemoteNode(NODE, canopen.import_od(str(DUAL), NODE))
    with (
        on_a_virtual_bus(DUAL, node) as (drive, channel),
        can.Bus(interface="virtual", channel=channel) as listener,
    ):
        yield drive, node, listener


def test_the_device_types_are_those_of_several_logical_devices() -> None:
    """CiA 301, 1000h: FFFFh and the profile of the first; each one's own type at 67FFh + 800h an axis."""
    with driven() as (_, node, _):
        assert [node.sdo[index].raw for index in (0x1000, 0x67FF, 0x6FFF)] == [0xFFFF_0192, 0x0002_0192, 0x0002_0192]


def test_each_axis_is_moved_by_its_own_objects() -> None:
    with driven() as (drive, node, _):
        second = drive.axis(2)
        enable(node, 3, 0x800)
        assert (drive.state, second.state) == (State.SWITCH_ON_DISABLED, State.OPERATION_ENABLED)
        node.sdo[0x68FF].raw = TURN_PER_S
        eventually(lambda: second.velocity_rpm > 55.0)
        assert drive.velocity_rpm == 0.0
        enable(node, 3)
        node.sdo[0x60FF].raw = -TURN_PER_S
        eventually(lambda: drive.velocity_rpm < -55.0)
        assert second.velocity_rpm == pytest.approx(60.0, rel=0.05)
        assert node.sdo[0x606C].raw == pytest.approx(-TURN_PER_S, rel=0.1)
        assert node.sdo[0x686C].raw == pytest.approx(TURN_PER_S, rel=0.1)


def test_process_data_of_the_second_axis_go_by_rpdo65_and_tpdo65() -> None:
    """1440h/1640h and 1840h/1A40h: set up by canopen, and read on the wire as their bytes."""
    with driven() as (_, node, listener):
        node.rpdo.read()
        node.tpdo.read()
        received, sent = node.rpdo[65], node.tpdo[65]
        for pdo, cob_id in ((received, 0x300 + NODE), (sent, 0x380 + NODE)):
            pdo.cob_id, pdo.enabled, pdo.trans_type = cob_id, True, 1
            pdo.save()
        assert [node.sdo[0x1640][sub].raw for sub in (1, 2)] == [0x6840_0010, 0x68FF_0020]
        assert [node.sdo[0x1A40][sub].raw for sub in (1, 2, 3)] == [0x6841_0010, 0x6877_0010, 0x6864_0020]
        node.sdo[0x6860].raw = 9
        node.nmt.state = "OPERATIONAL"
        for word in (0x06, 0x07, 0x0F, 0x0F):
            node.network.send_message(0x300 + NODE, struct.pack("<Hi", word, TURN_PER_S))
            node.network.sync.transmit()
        eventually(lambda: node.sdo[0x6841].raw & 0x6F == ENABLED)
        eventually(lambda: node.sdo[0x686C].raw > 0.9 * TURN_PER_S)
        while listener.recv(0.0) is not None:
            pass
        node.network.sync.transmit()
        frames = {frame.arbitration_id: bytes(frame.data) for frame in iter(lambda: listener.recv(0.5), None)}
        assert len(frames[0x380 + NODE]) == 8
        statusword, _, position = struct.unpack("<Hhi", frames[0x380 + NODE])
        assert statusword & 0x6F == ENABLED
        assert position > 0
        assert struct.unpack("<Hhi", frames[0x180 + NODE])[0] & 0x6F == 0x40  # the first axis has no power


def test_one_axis_fails_and_the_other_goes_on() -> None:
    with driven() as (drive, node, listener):
        enable(node, 3)
        enable(node, 3, 0x800)
        drive.axis(2).fault(0x8611)
        eventually(lambda: drive.axis(2).state is State.FAULT)
        assert drive.state is State.OPERATION_ENABLED
        assert (node.sdo[0x603F].raw, node.sdo[0x683F].raw) == (0, 0x8611)
        assert node.sdo[0x1001].raw & 0x21 == 0x21
        node.sdo[0x6840].raw = 0x80
        eventually(lambda: node.sdo[0x1001].raw == 0)
        told = [bytes(f.data) for f in iter(lambda: listener.recv(0.3), None) if f.arbitration_id == 0x80 + NODE]
        assert [data[:2] for data in told] == [b"\x11\x86", b"\0\0"]


class OnOneDevice:
    """Both axes on a device without a bus."""

    def __init__(self) -> None:
        self.device = Device(load_eds(DUAL, NODE), NODE, StandingClock())
        self.ports = [MotorPort(), MotorPort()]
        self.drives = [Cia402Drive(self.device, port, axis=axis) for axis, port in enumerate(self.ports, 1)]
        self.device.boot()
        self.device.handle(Frame(0, bytes([1, NODE])))
        self.device.outbox.clear()

    def enable(self) -> None:
        for offset in (0, 0x800):
            self.device.cell(0x6060 + offset).write(9)
            for word in (0x06, 0x07, 0x0F):
                self.device.cell(0x6040 + offset).write(word)

    def cycle(self) -> None:
        for drive in self.drives:
            drive.sync(0.002)
            drive.publish()

    def emergencies(self) -> list[tuple[int, int]]:
        """Error code and error register of what has been told."""
        return [struct.unpack("<HB", f.data[:3]) for f in self.device.outbox if f.can_id == 0x80 + NODE]


def test_the_same_fault_of_both_is_told_of_each_and_stands_until_both_are_reset() -> None:
    node = OnOneDevice()
    node.enable()
    for drive in node.drives:
        drive.fault(0x8611)
    node.cycle()
    assert node.emergencies() == [(0x8611, 0x21), (0x8611, 0x21)]
    node.device.cell(0x6040).write(0x80)
    assert [drive.state for drive in node.drives] == [State.SWITCH_ON_DISABLED, State.FAULT]
    assert node.device.cell(0x1001).value == 0x21
    node.device.cell(0x6840).write(0x80)
    assert node.device.cell(0x1001).value == 0
    assert [code for code, _ in node.emergencies()] == [0x8611, 0x8611, 0, 0]


def test_nmt_and_a_lost_master_are_for_both_axes_each_by_its_own_option_code() -> None:
    node = OnOneDevice()
    node.device.cell(0x6007).write(1)
    node.device.cell(0x6807).write(2)
    node.enable()
    assert node.device.on_communication_error is not None
    node.device.on_communication_error(0x8130)
    node.cycle()
    assert [drive.state for drive in node.drives] == [State.FAULT, State.SWITCH_ON_DISABLED]
    node.device.handle(Frame(0, bytes([129, NODE])))
    assert [drive.state for drive in node.drives] == [State.SWITCH_ON_DISABLED] * 2
    assert node.device.cell(0x683F).value == 0


def test_the_fault_on_command_of_the_second_axis_is_at_2801h() -> None:
    node = OnOneDevice()
    node.enable()
    node.device.cell(0x2801).write(0x7500)
    assert [drive.state for drive in node.drives][1] is not State.OPERATION_ENABLED
    assert (node.device.cell(0x603F).value, node.device.cell(0x683F).value) == (0, 0x7500)


def test_events_are_of_an_axis_that_there_is() -> None:
    behaviour = Behaviour.model_validate({"events": [{"at_s": 1.0, "fault": 0x8611, "axis": 3}]})
    with pytest.raises(UnusableInputError, match=r"event of axis 3, expected one of those that it has: 1, 2"):
        SimulatedDrive(DUAL, NODE, "virtual:x", behaviour=behaviour)
    with pytest.raises(ValueError, match="of the whole node"):
        Behaviour.model_validate({"events": [{"at_s": 1.0, "silent_s": 1.0, "axis": 2}]})
