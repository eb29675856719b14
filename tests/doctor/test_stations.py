"""Who is on the bus, and whether the devices are those of the EDS files: over an in-memory bus."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from tests.canopen.device_under_test import Idle

import can
from hilbench.apps.canopen_tools.bus_scan import scan
from hilbench.apps.doctor.check_stations import ask, check_node, check_received
from hilbench.apps.doctor.findings import Check, Finding, Level
from hilbench.apps.doctor.subject import ExpectedNode, expected_nodes
from hilbench.can.frame import Frame
from hilbench.can.memory import MemoryBus
from hilbench.canopen.clock import MonotonicClock
from hilbench.canopen.device import Device
from hilbench.canopen.eds import load_eds
from hilbench.canopen.emergency_stop import EMERGENCY_STOP
from hilbench.canopen.host import DeviceHost
from hilbench.canopen.listening import present, sort_by_node
from hilbench.canopen.sdo_client import Refusal, SdoClient
from hilbench.errors import BusError
from hilbench.exchange.nodes import Nodes
from hilbench.runs.config import load

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def nodes() -> list[ExpectedNode]:
    config, _ = load(ROOT / "bench_configs" / "web_section_step.yaml")
    return expected_nodes(Nodes(config))


def levels(findings: list[Finding]) -> dict[Check, Level]:
    return {finding.check: finding.level for finding in findings}


def frames(*identifiers: int) -> list[Frame]:
    return [Frame(identifier, b"") for identifier in identifiers]


def test_the_nodes_of_the_config_are_known_by_their_eds(nodes: list[ExpectedNode]) -> None:
    axis = nodes[0]
    assert (axis.part, axis.node_id, axis.ours, axis.device_type) == ("axis1", 1, True, 0x00020192)
    assert [(item.index, item.bits) for item in axis.mapped] == [
        (0x6040, 16),
        (0x6041, 16),
        (0x6064, 32),
        (0x606C, 32),
        (0x6077, 16),
        (0x60FF, 32),
    ]
    assert [(item.index, item.sub) for item in nodes[-1].mapped if item.index == 0x6413] == [(0x6413, 1), (0x6413, 2)]


def test_only_what_a_node_sends_counts_as_heard() -> None:
    received = sort_by_node(frames(0x000, 0x080, 0x085, 0x181, 0x201, 0x281, 0x583, 0x603, 0x77F, 0x100))
    assert received.sync
    assert received.nodes == {1: {0x181, 0x281}, 3: {0x583}, 5: {0x085}, 127: {0x77F}}


def test_strangers_and_another_master(nodes: list[ExpectedNode]) -> None:
    quiet = check_received(sort_by_node(frames(0x181, 0x703)), nodes, 127, "can0")
    assert levels(quiet) == {Check.OTHER_MASTER: Level.OK, Check.STRANGERS: Level.OK}
    stranger = check_received(sort_by_node(frames(0x185, 0x705)), nodes, 127, "can0")
    assert levels(stranger) == {Check.OTHER_MASTER: Level.OK, Check.STRANGERS: Level.WARNING}
    assert "node 5 (185h 705h)" in stranger[1].found
    for identifier in (0x000, 0x080, 0x201, 0x543, 0x77F):
        busy = check_received(sort_by_node(frames(identifier)), nodes, 127, "can0")
        assert levels(busy) == {Check.OTHER_MASTER: Level.ERROR, Check.STRANGERS: Level.OK}
        assert f"{identifier:03X}h" in busy[0].found
        assert "no program of this machine" in busy[0].found
        on_a_bus_alone = check_received(sort_by_node(frames(identifier)), [], 127, "can0")
        assert levels(on_a_bus_alone)[Check.OTHER_MASTER] is Level.ERROR
    idle = check_received(sort_by_node([]), nodes, 127, "can0", claimed_by="bench line2 (process 4711)")
    assert levels(idle)[Check.OTHER_MASTER] is Level.ERROR
    assert "bench line2 (process 4711)" in idle[0].found


def test_an_emergency_stop_on_the_bus_is_no_other_master() -> None:
    received = sort_by_node([*EMERGENCY_STOP, *frames(0x701)])
    assert received.signs_of_master(127) == []
    received = sort_by_node([EMERGENCY_STOP[1]])  # the NMT command alone is one
    assert received.signs_of_master(127) == ["NMT commands (000h, 1 frame)"]


@pytest.fixture
def bus() -> Iterator[MemoryBus]:
    """A bus with a simulated drive at node id 1, in PRE-OPERATIONAL."""
    bus = MemoryBus()
    device = Device(load_eds(ROOT / "eds" / "hilbench_servo.eds", 1), 1, MonotonicClock())
    stop = threading.Event()
    host = DeviceHost(bus.open_link(), [device], MonotonicClock(), Idle())
    thread = threading.Thread(target=host.run, args=(stop.is_set,))
    thread.start()
    yield bus
    stop.set()
    thread.join()


def examine(bus: MemoryBus, node: ExpectedNode) -> list[Finding]:
    with SdoClient(bus.open_python_can(), timeout_s=0.3) as reader:
        return check_node(node, ask(reader, node))


def test_a_device_that_is_what_its_eds_says(bus: MemoryBus, nodes: list[ExpectedNode]) -> None:
    findings = examine(bus, nodes[0])
    assert levels(findings) == {
        Check.NODE_ANSWERS: Level.OK,
        Check.IDENTITY: Level.OK,
        Check.MAPPED_OBJECTS: Level.OK,
    }


def test_the_eds_of_another_device(bus: MemoryBus, nodes: list[ExpectedNode]) -> None:
    item = nodes[0].mapped[0]
    other = replace(
        nodes[0],
        identity=(frozenset({0x65, 0xFF}), frozenset(), frozenset()),
        mapped=(replace(item, bits=32), replace(item, index=0x6099, sub=1, name="Homing speeds"), item),
    )
    answers, identity, *mapped = examine(bus, other)
    assert answers.level is Level.OK
    assert (identity.level, identity.found) == (Level.ERROR, "vendor id 00000000h")
    assert identity.expected.startswith("00000065h or 000000FFh")
    assert [finding.level for finding in mapped] == [Level.ERROR, Level.ERROR]
    assert "6040h" in mapped[0].found
    assert "16 bits" in mapped[0].found
    assert mapped[0].expected.startswith("32 bits")
    assert "6099h sub 1 'Homing speeds': abort 06020000h" in mapped[1].found


@pytest.mark.parametrize(
    ("given", "level"),
    [
        ({"identity": (frozenset(), frozenset({1}), frozenset())}, Level.ERROR),
        ({"identity": (frozenset(), frozenset({0x402}), frozenset({0x20000}))}, Level.WARNING),
        ({"identity": (frozenset(), frozenset({0x402, 7}), frozenset({0x10000}))}, Level.OK),
        ({"device_type": 0x191}, Level.ERROR),
        ({"device_type": 0xFFFF0192}, Level.OK),  # the upper half is the maker's
        ({"device_type": None, "identity": (frozenset(), frozenset(), frozenset())}, Level.OK),
    ],
)
def test_identity(nodes: list[ExpectedNode], given: dict[str, object], level: Level) -> None:
    words = [number.to_bytes(4, "little") for number in (0x00020192, 0, 0x402, 0x10000)]
    node = replace(nodes[0], mapped=(), **given)  # type: ignore[arg-type]
    answers = dict(zip([(0x1000, 0), (0x1018, 1), (0x1018, 2), (0x1018, 3)], words, strict=True))
    assert levels(check_node(node, answers))[Check.IDENTITY] is level


def test_an_object_that_can_only_be_written_is_there(nodes: list[ExpectedNode]) -> None:
    word = bytes(4)
    node = replace(nodes[0], device_type=None, identity=(frozenset(),) * 3, mapped=nodes[0].mapped[:1])
    answers = {(0x1000, 0): word, **{(0x1018, sub): word for sub in (1, 2, 3)}, (0x6040, 0): Refusal(0x06010001)}
    assert levels(check_node(node, answers))[Check.MAPPED_OBJECTS] is Level.OK


def test_a_silent_node(bus: MemoryBus, nodes: list[ExpectedNode]) -> None:
    (real,) = examine(bus, replace(nodes[1], ours=False))
    assert (real.check, real.level) == (Check.NODE_ANSWERS, Level.ERROR)
    (ours,) = examine(bus, nodes[1])
    assert ours.level is Level.ERROR
    assert "hilbench simulate-hardware CONFIG" in ours.advice


def test_a_scan_finds_a_node_that_answers_after_a_tenth_of_a_second() -> None:
    memory = MemoryBus()
    theirs = memory.open_python_can()

    def answer(message: can.Message) -> None:
        if message.arbitration_id == 0x609:
            data = b"\x43" + bytes(message.data[1:4]) + bytes(4)
            late = can.Message(arbitration_id=0x589, data=data, is_extended_id=False)
            threading.Timer(0.12, theirs.send, [late]).start()

    notifier = can.Notifier(theirs, [answer])
    link = memory.open_link()
    with SdoClient(memory.open_python_can(), timeout_s=1.0) as reader:
        found = scan(link, reader, [], 0.0, 127)
    notifier.stop()
    link.close()
    theirs.shutdown()
    assert [station.node_id for station in found.stations] == [9]


def test_a_scan_finds_all_nodes_of_a_slow_bus_and_says_how_long_it_waited() -> None:
    """At 10 kbit/s sixteen requests and their answers take 0.4 s, and nodes take their time before they answer."""
    memory = MemoryBus()
    theirs, there = memory.open_python_can(), (1, 9, 16)
    sent_s = [0.0]

    def answer(message: can.Message) -> None:
        node_id = message.arbitration_id - 0x600
        sent_s[0] = max(sent_s[0], time.monotonic()) + 0.013 * (2 if node_id in there else 1)
        if node_id in there:
            data = b"\x43" + bytes(message.data[1:4]) + bytes(4)
            late = can.Message(arbitration_id=0x580 + node_id, data=data, is_extended_id=False)
            threading.Timer(sent_s[0] - time.monotonic() + 0.12, theirs.send, [late]).start()

    notifier = can.Notifier(theirs, [answer])
    link = memory.open_link()
    with SdoClient(memory.open_python_can(), timeout_s=1.0) as reader:
        found = scan(link, reader, [], 0.0, 127, bitrate=10_000)
    notifier.stop()
    link.close()
    theirs.shutdown()
    assert [station.node_id for station in found.stations] == list(there)
    assert found.waited_s == pytest.approx(0.3 + 32 * 0.0135)


def test_a_bus_that_is_lost_is_no_silent_node() -> None:
    can_bus = MemoryBus().open_python_can()
    reader = SdoClient(can_bus, timeout_s=0.1)
    try:
        can_bus.send = lost  # type: ignore[method-assign]
        with pytest.raises(BusError, match="node 5 could not be sent: Network is down"):
            reader.read(5, 0x1000)
    finally:
        reader.close()


def lost(message: can.Message, timeout: float | None = None) -> None:
    raise can.CanOperationError("Network is down")


def test_who_is_there_is_asked_in_one_go(bus: MemoryBus) -> None:
    link = bus.open_link()
    assert present(link, [1, 2, 17], 0.3) == {1}
    link.close()
