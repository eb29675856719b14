"""LSS of a device: the standard's bytes, and canopen's master as an independent opposite."""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable

import pytest
from canopen.lss import LssMaster
from hypothesis import given, settings
from hypothesis import strategies as st

from hilbench.can.frame import Frame
from hilbench.can.memory import MemoryBus
from hilbench.can.python_can import can
from hilbench.canopen.identifiers import LSS_ANSWER, NMT
from hilbench.canopen.lss_master import LssMaster as OurMaster
from hilbench.canopen.lss_slave import UNCONFIGURED, LssSettings, LssSlave, LssState
from hilbench.canopen.master import Identity
from hilbench.errors import BusError

NUMBER = st.integers(0, 0xFFFF_FFFF)
ADDRESS = st.tuples(NUMBER, NUMBER, NUMBER, NUMBER)
IDENTITY = (0x2A, 0x402, 0x10000, 7)


class Bus:
    """Slaves on a bus without time: an answer is there when the request has been sent."""

    def __init__(self, *slaves: LssSlave) -> None:
        self.slaves = slaves
        self.answer: Callable[[int, bytes, float], None] = lambda *_: None

    def send_message(self, can_id: int, data: bytes) -> None:
        assert can_id == 0x7E5
        for slave in self.slaves:
            frame = slave.handle(bytes(data))
            if frame is not None:
                assert (frame.can_id, len(frame.data)) == (LSS_ANSWER, 8)
                self.answer(frame.can_id, frame.data, 0.0)


def master(*slaves: LssSlave) -> LssMaster:
    bus, lss = Bus(*slaves), LssMaster()
    bus.answer, lss.network, lss.RESPONSE_TIMEOUT = lss.on_message_received, bus, 0.001  # type: ignore[assignment]
    return lss


@pytest.fixture(autouse=True)
def _no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    """canopen leaves devices time between requests."""
    monkeypatch.setattr("canopen.lss.time.sleep", lambda _s: None)


@settings(max_examples=20, deadline=None)
@given(ADDRESS)
def test_a_fast_scan_finds_whoever_has_no_node_id(address: tuple[int, int, int, int]) -> None:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("canopen.lss.time.sleep", lambda _s: None)
        slave = LssSlave(address, UNCONFIGURED)
        assert master(slave).fast_scan() == (True, list(address))
    assert slave.state is LssState.CONFIGURATION


def test_scans_find_one_after_the_other_and_not_those_that_have_a_node_id() -> None:
    slaves = [LssSlave((*IDENTITY[:3], serial), UNCONFIGURED) for serial in (9, 3, 5)]
    lss = master(*slaves, LssSlave((*IDENTITY[:3], 1), 20))
    found = [lss.fast_scan() for _ in range(4)]
    assert [numbers[3] for there, numbers in found[:3] if there] == [3, 5, 9]
    assert found[3] == (False, None)


def test_the_one_that_is_selected_takes_a_node_id_and_a_bit_rate_and_keeps_them() -> None:
    slave, other = LssSlave(IDENTITY, UNCONFIGURED), LssSlave((*IDENTITY[:3], 8), 20)
    lss = master(slave, other)
    assert lss.send_switch_state_selective(*IDENTITY)
    lss.configure_node_id(5)
    lss.configure_bit_timing(2)
    lss.store_configuration()
    assert lss.inquire_node_id() == UNCONFIGURED
    lss.send_switch_state_global(0)
    assert slave.take_effect()
    assert slave.node_id == 5
    assert slave.stored == LssSettings(5, 500_000)
    assert (other.pending, other.stored) == (LssSettings(20), None)


@given(ADDRESS, ADDRESS)
def test_only_the_whole_address_selects(address: tuple[int, int, int, int], asked: tuple[int, int, int, int]) -> None:
    slave = LssSlave(address, 5)
    for service, number in enumerate(asked, 0x40):
        answer = slave.handle(struct.pack("<BI3x", service, number))
    assert (slave.state is LssState.CONFIGURATION) is (asked == address)
    assert (answer is not None) is (asked == address)


@pytest.mark.parametrize(
    ("request_bytes", "answer"),
    [
        ("11 00 00 00 00 00 00 00", "11 01 00 00 00 00 00 00"),  # node id 0
        ("11 80 00 00 00 00 00 00", "11 01 00 00 00 00 00 00"),  # 128
        ("11 7F 00 00 00 00 00 00", "11 00 00 00 00 00 00 00"),
        ("11 FF 00 00 00 00 00 00", "11 00 00 00 00 00 00 00"),  # none
        ("13 00 05 00 00 00 00 00", "13 01 00 00 00 00 00 00"),  # reserved
        ("13 01 02 00 00 00 00 00", "13 01 00 00 00 00 00 00"),  # another table
        ("13 00 08 00 00 00 00 00", "13 00 00 00 00 00 00 00"),
        ("17 00 00 00 00 00 00 00", "17 00 00 00 00 00 00 00"),
        ("5A 00 00 00 00 00 00 00", "5A 2A 00 00 00 00 00 00"),
        ("5B 00 00 00 00 00 00 00", "5B 02 04 00 00 00 00 00"),
        ("5C 00 00 00 00 00 00 00", "5C 00 00 01 00 00 00 00"),
        ("5D 00 00 00 00 00 00 00", "5D 07 00 00 00 00 00 00"),
        ("5E 00 00 00 00 00 00 00", "5E 14 00 00 00 00 00 00"),
        ("15 E8 03 00 00 00 00 00", None),  # a bit rate becomes active: nobody answers
        ("77 00 00 00 00 00 00 00", None),
        ("11 05", None),  # LSS frames have eight bytes
    ],
)
def test_services_of_the_configuration_state_by_their_bytes(request_bytes: str, answer: str | None) -> None:
    slave = LssSlave(IDENTITY, 20)
    assert slave.handle(bytes.fromhex(request_bytes)) is None, "waiting, it leaves all of them alone"
    slave.handle(bytes.fromhex("04 01 00 00 00 00 00 00"))
    frame = slave.handle(bytes.fromhex(request_bytes))
    assert (None if frame is None else frame.data.hex(" ").upper()) == answer


def test_who_has_an_address_in_a_range_says_so() -> None:
    slave = LssSlave(IDENTITY, 20)

    def asked(*numbers: int) -> bool:
        answers = [slave.handle(struct.pack("<BI3x", 0x46 + step, number)) for step, number in enumerate(numbers)]
        assert answers[:5] == [None] * 5
        return answers[5] is not None and answers[5].data[0] == 0x4F

    assert asked(0x2A, 0x402, 0x10000, 0x1FFFF, 7, 7)
    assert not asked(0x2A, 0x402, 0x10001, 0x1FFFF, 7, 7)
    assert not asked(0x2A, 0x403, 0, 0xFFFF_FFFF, 0, 0xFFFF_FFFF)
    assert not asked(0x2A, 0x402, 0, 0xFFFF_FFFF, 8, 9)


@given(st.lists(st.binary(min_size=0, max_size=8), max_size=30))
def test_no_frame_brings_it_out_of_order(frames: list[bytes]) -> None:
    slave = LssSlave(IDENTITY, 20)
    for frame in frames:
        slave.handle(frame)
    assert slave.node_id == 20
    assert slave.pending.node_id == UNCONFIGURED or 1 <= slave.pending.node_id <= 127


class AnswersAgain(LssSlave):
    """As CANopenNode does: who was found by a fastscan takes part in the next one."""

    def handle(self, data: bytes) -> Frame | None:
        if data[0] == 0x51 and data[5] == 0x80:
            self.state = LssState.WAITING
        return super().handle(data)


def test_a_device_that_answers_each_scan_is_found_once_and_takes_its_node_id() -> None:
    identity = (1, 0, 0, 8)  # a scan waits for nobody's answer at each bit that is 1
    slave = AnswersAgain(identity, UNCONFIGURED)
    stop = threading.Event()
    with can.Bus(interface="virtual", channel="lss-again") as theirs:

        def serve() -> None:
            while not stop.is_set():
                message = theirs.recv(0.02)
                frame = None if message is None else slave.handle(bytes(message.data))
                if frame is not None:
                    theirs.send(can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False))

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            with OurMaster(can.Bus(interface="virtual", channel="lss-again"), timeout_s=0.2) as lss:
                assert lss.find_unconfigured() == [Identity(*identity)]
                lss.select(Identity(*identity))
                lss.give_node_id(5)
                lss.store()
        finally:
            stop.set()
            thread.join()
    assert slave.stored == LssSettings(5)


def test_a_bus_that_is_lost_while_a_device_is_reset_is_said_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = MemoryBus().open_python_can()
    send = bus.send

    def lose(message: can.Message, timeout: float | None = None) -> None:
        if message.arbitration_id == NMT:
            raise can.CanOperationError("the cable is out")
        send(message, timeout)

    monkeypatch.setattr(bus, "send", lose)
    with OurMaster(bus, 0.01) as ours, pytest.raises(BusError, match="the cable is out"):
        ours.boots(5, old_id=4, timeout_s=0.0)
