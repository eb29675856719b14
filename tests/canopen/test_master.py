"""The master and canopen's own client against a device host, on a bus."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
from tests.buses import Bus
from tests.canopen.device_under_test import NODE, SECTIONS, U32, eds_text, var

import can
import canopen
from hilbench.can.frame import Frame
from hilbench.canopen.clock import MonotonicClock
from hilbench.canopen.concise_dcf import Write
from hilbench.canopen.device import Device
from hilbench.canopen.device_configuration import read_device, settings, write_device
from hilbench.canopen.eds import load_eds
from hilbench.canopen.host import DeviceHost
from hilbench.canopen.identifiers import NmtCommand, NmtState
from hilbench.canopen.master import Master
from hilbench.canopen.pdo import PdoMap
from hilbench.errors import BenchFaultError, BusError


class Idle:
    """An application without a plant."""

    listens_to: frozenset[int] = frozenset()

    def before_sync(self, behind: int) -> None:
        pass

    def after_sync(self) -> None:
        pass

    def on_frame(self, frame: Frame) -> None:
        pass

    def tick(self, duration_s: float) -> None:
        pass


class Rig:
    def __init__(self, folder: Path, bus: Bus, sections: Mapping[str, str] = SECTIONS) -> None:
        path = folder / "device.eds"
        path.write_text(eds_text(sections), encoding="ascii")
        self.bus = bus
        self.od = load_eds(path, NODE)
        clock = MonotonicClock()
        self.device = Device(load_eds(path, NODE), NODE, clock)
        self._link = self.bus.open_link()
        self._host = DeviceHost(self._link, [self.device], clock, Idle())
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._host.run, args=(self._stop.is_set,))

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._link.close()


@pytest.fixture
def rig(tmp_path: Path, bus: Bus) -> Iterator[Rig]:
    made = Rig(tmp_path, bus)
    yield made
    made.stop()


@pytest.fixture
def master(rig: Rig) -> Iterator[Master]:
    made = Master(rig.bus.open_python_can())
    made.add(NODE, rig.od, "axis 1")
    yield made
    made.close()


def test_boot_configure_and_identity(rig: Rig, master: Master) -> None:
    rig.start()
    master.wait_for_boot([NODE], 5.0)
    master.configure(NODE, {(0x2000, 0): 42, (0x2006, 0): -0.5, (0x2004, 0): -3, (0x2002, 0): "a longer text"})
    assert master.sdo_read(NODE, 0x2000) == 42
    assert rig.device.cell(0x2004).value == -3
    assert master.sdo_read(NODE, 0x1018, 1) == 0x1234


def test_pdo_map_is_written_and_read_back(rig: Rig, master: Master) -> None:
    rig.start()
    master.wait_for_boot([NODE], 5.0)
    pdo = PdoMap.from_names(rig.od, 0x1A5, 2, ["torque_actual_value", "position_actual_value"], 0x1800)
    master.write_pdo(NODE, pdo)
    assert master.sdo_read(NODE, 0x1800, 1) & 0x7FF == 0x1A5
    assert master.sdo_read(NODE, 0x1800, 2) == 2
    assert [master.sdo_read(NODE, 0x1A00, sub) for sub in (0, 1, 2)] == [2, 0x60770010, 0x60640020]


@pytest.fixture
def fixed_rig(tmp_path: Path, bus: Bus) -> Iterator[Rig]:
    """A device whose COB-IDs are read-only, and its mappings are not."""
    fixed = {
        f"{index:04X}sub1": var("COB-ID", U32, "ro", f"$NODEID+0x{cob_id:X}")
        for index, cob_id in ((0x1400, 0x200), (0x1401, 0x300), (0x1800, 0x40000180), (0x1801, 0x40000280))
    }
    made = Rig(tmp_path, bus, SECTIONS | fixed)
    made.start()
    yield made
    made.stop()


def test_pdos_of_a_device_with_read_only_cob_ids_are_mapped_and_loaded(fixed_rig: Rig) -> None:
    master = Master(fixed_rig.bus.open_python_can())
    try:
        master.add(NODE, fixed_rig.od, "axis 1")
        master.wait_for_boot([NODE], 5.0)
        before = settings(read_device(master, NODE, fixed_rig.od))
        master.write_pdo(NODE, PdoMap.from_names(fixed_rig.od, 0x200 + NODE, 1, [0x6040, 0x6071], 0x1400))
        master.write_pdo(NODE, PdoMap.from_names(fixed_rig.od, 0x180 + NODE, 1, [0x6041], 0x1800))
        assert [cell.variable.index for cell in fixed_rig.device.synchronous_pdos[0].cells] == [0x6041]
        master.disable_pdo(NODE, 0x1801)
        assert fixed_rig.device.cell(0x1A01).value == 0
        assert write_device(master, NODE, before) == {}
        assert [fixed_rig.device.cell(0x1A00, sub).value for sub in range(3)] == [2, 0x60410010, 0x60640020]
        with pytest.raises(BenchFaultError, match=r"1400h reads back COB-ID 205h, .* expected 305h, 1"):
            master.write_pdo(NODE, PdoMap.from_names(fixed_rig.od, 0x300 + NODE, 1, [0x6040], 0x1400))
    finally:
        master.close()


def test_pdo_that_reads_back_otherwise_is_a_fault(rig: Rig, master: Master) -> None:
    rig.device.cell(0x1800, 2).on_read = lambda: 9  # a device that has a will of its own
    rig.start()
    with pytest.raises(BenchFaultError, match=r"1800h reads back .* type 9, expected 1A5h, 2"):
        master.write_pdo(NODE, PdoMap.from_names(rig.od, 0x1A5, 2, ["torque_actual_value"], 0x1800))


@pytest.mark.parametrize(
    ("index", "value", "message"),
    [
        (0x2000, 101, "axis 1 (node 5), 2000h sub 0 'Parameter': writing 101 to it: abort 06090031h"),
        (0x1008, "x", "axis 1 (node 5), 1008h sub 0 'Device name': writing 'x' to it: abort 06010002h"),
    ],
)
def test_refusal_names_node_object_and_reason(
    rig: Rig, master: Master, index: int, value: int | str, message: str
) -> None:
    rig.start()
    with pytest.raises(BenchFaultError, match=re.escape(message)) as error:
        master.sdo_write(NODE, index, value)
    assert "\n" not in str(error.value)


def test_value_out_of_its_type_is_a_fault_not_a_traceback(rig: Rig, master: Master) -> None:
    with pytest.raises(BenchFaultError, match="'Parameter': writing 70000"):
        master.sdo_write(NODE, 0x2000, 70000)


def test_silent_node_is_named_with_what_was_tried(rig: Rig) -> None:
    master = Master(rig.bus.open_python_can(), sdo_timeout_s=0.05)
    master.add(NODE, rig.od, "axis 1")
    with pytest.raises(BenchFaultError, match=r"axis 1 \(node 5\): no boot-up or heartbeat .*1000h"):
        master.wait_for_boot([NODE], 0.1)
    with pytest.raises(
        BenchFaultError, match=r"axis 1 \(node 5\), 1000h sub 0 'Device type'.*no answer within 0\.05 s"
    ):
        master.sdo_read(NODE, 0x1000)
    master.close()


def test_who_is_silent_beside_those_waited_for_is_named_as_well(rig: Rig) -> None:
    master = Master(rig.bus.open_python_can(), sdo_timeout_s=0.05)
    master.add(NODE, rig.od, "axis 1")
    master.add(NODE + 1, rig.od, "twin")
    with pytest.raises(BenchFaultError, match=r"no answer from axis 1 \(node 5\), twin \(node 6\):"):
        master.wait_for_boot([NODE], 0.1, beside=[NODE + 1])
    rig.start()
    master.wait_for_boot([NODE], 5.0, beside=[NODE + 1])
    master.close()


def test_nmt(rig: Rig, master: Master) -> None:
    changed = threading.Event()
    rig.start()
    master.wait_for_boot([NODE], 5.0)
    rig.device.on_nmt = lambda state: changed.set()
    master.nmt(NmtCommand.START, NODE)
    assert changed.wait(5.0)
    assert rig.device.nmt_state is NmtState.OPERATIONAL


class BusThatIsLost(can.BusABC):
    """A python-can bus that nothing comes from, and whose other end goes away when told."""

    def __init__(self) -> None:
        self.lost = threading.Event()
        super().__init__("none")

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        pass

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self.lost.wait(timeout):
            raise can.CanOperationError("its hub has ended")
        return None, True


def test_a_lost_bus_is_an_error_where_it_is_used_next_and_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    ended_by = []
    monkeypatch.setattr(threading, "excepthook", lambda hooked: ended_by.append(hooked.exc_type))
    bus = BusThatIsLost()
    before = set(threading.enumerate())
    master = Master(bus)
    receiving = set(threading.enumerate()) - before
    assert receiving
    bus.lost.set()
    for thread in receiving:
        thread.join(10.0)
        assert not thread.is_alive()
    with pytest.raises(BusError, match="its hub has ended"):
        master.nmt(NmtCommand.START)
    master.close()
    assert ended_by == [SystemExit]  # of which Python prints nothing


def test_canopens_client_reads_writes_maps_and_transfers_blocks(rig: Rig) -> None:
    network = canopen.Network(rig.bus.open_python_can())
    network.connect()
    node = network.add_node(NODE, rig.od)
    node.sdo.RESPONSE_TIMEOUT = 5.0
    rig.start()
    try:
        assert node.sdo["Device name"].raw == "hilbench test device"
        node.sdo["Parameter"].raw = 12
        assert rig.device.cell(0x2000).value == 12
        with pytest.raises(canopen.SdoAbortedError) as refused:
            node.sdo["Statusword"].raw = 1
        assert refused.value.code == 0x06010002

        node.tpdo.read()
        node.tpdo[2].clear()
        node.tpdo[2].add_variable("Position actual value")
        node.tpdo[2].trans_type = 255
        node.tpdo[2].enabled = True
        node.tpdo.save()
        node.nmt.state = "OPERATIONAL"
        rig.device.cell(0x6064).value = -123456
        node.tpdo[2].wait_for_reception(5.0)
        while node.tpdo[2]["Position actual value"].raw != -123456:
            assert node.tpdo[2].wait_for_reception(5.0) is not None

        data = bytes(range(256)) * 8
        with node.sdo.open(0x2003, 0, "wb", size=len(data), block_transfer=True) as stream:
            stream.write(data)
        assert rig.device.cell(0x2003).value == data
        with node.sdo.open(0x2003, 0, "rb", block_transfer=True) as stream:
            assert stream.read() == data
    finally:
        network.disconnect()


def test_objects_that_are_not_answered_are_listed_and_the_others_read(tmp_path: Path) -> None:
    """1001h is not answered at all, 1005h by the value of another object."""
    file = tmp_path / "device.eds"
    file.write_text(eds_text(), encoding="ascii")
    od = load_eds(file, NODE)

    def answer(message: can.Message) -> None:
        mux = bytes(message.data[1:4])
        if message.arbitration_id == 0x600 + NODE and message.data[0] == 0x40 and mux != b"\x01\x10\0":
            said = b"\0\x20\0" if mux == b"\x05\x10\0" else mux
            theirs.send(can.Message(arbitration_id=0x580 + NODE, data=b"\x43" + said + bytes(4), is_extended_id=False))

    with can.Bus(interface="virtual", channel="odd-answers") as theirs:
        notifier = can.Notifier(theirs, [answer])
        master = Master(can.Bus(interface="virtual", channel="odd-answers"), 0.2)
        master.add(NODE, od, "axis 1")
        found = read_device(master, NODE, od)
        with pytest.raises(BenchFaultError, match=r"1005h.*reading it: wrong answer: Node returned a value for 0x2000"):
            master.sdo_read(NODE, 0x1005)
        master.close()
        notifier.stop()
    assert set(found.refused) == {(0x1001, 0), (0x1005, 0)}
    assert (0x1000, 0) in found.values


def test_an_object_that_is_slow_to_write_is_listed_and_the_others_written(tmp_path: Path) -> None:
    file = tmp_path / "device.eds"
    file.write_text(eds_text(), encoding="ascii")
    written: list[bytes] = []

    def answer(message: can.Message) -> None:
        mux, said = bytes(message.data[1:4]), b"\x43"
        if message.arbitration_id != 0x600 + NODE or mux == b"\x01\x20\0" or message.data[0] == 0x80:
            return
        if message.data[0] != 0x40:
            written.append(mux)
            said = b"\x60"
        reply = said + mux + bytes(message.data[4:])
        theirs.send(can.Message(arbitration_id=0x580 + NODE, data=reply, is_extended_id=False))

    with can.Bus(interface="virtual", channel="slow-write") as theirs:
        notifier = can.Notifier(theirs, [answer])
        master = Master(can.Bus(interface="virtual", channel="slow-write"), 0.2)
        master.add(NODE, load_eds(file, NODE), "axis 1")
        failed = write_device(master, NODE, [Write(0x2001, 0, b"\1"), Write(0x2000, 0, b"\0\0")])
        master.close()
        notifier.stop()
    assert failed == {(0x2001, 0): "no answer within 0.2 s"}
    assert written == [b"\0\x20\0"]


def test_storing_may_take_longer_than_other_answers(tmp_path: Path) -> None:
    file = tmp_path / "device.eds"
    file.write_text(eds_text(), encoding="ascii")

    def answer(message: can.Message) -> None:
        if message.arbitration_id == 0x600 + NODE:
            time.sleep(0.3)
            data = b"\x60" + bytes(message.data[1:4]) + bytes(4)
            theirs.send(can.Message(arbitration_id=0x580 + NODE, data=data, is_extended_id=False))

    with can.Bus(interface="virtual", channel="slow-flash") as theirs:
        notifier = can.Notifier(theirs, [answer])
        master = Master(can.Bus(interface="virtual", channel="slow-flash"), 0.1)
        master.add(NODE, load_eds(file, NODE), "axis 1")
        master.sdo_write(NODE, 0x1010, int.from_bytes(b"save", "little"), 1)
        master.close()
        notifier.stop()
