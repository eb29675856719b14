"""The bus inside one process."""

from __future__ import annotations

import select
import threading

import pytest

import can
import canopen
from hilbench.can.disturbance import ErrorInjection
from hilbench.can.frame import EXTENDED_FLAG, REMOTE_FLAG, Frame
from hilbench.can.memory import RECEIVE_LIMIT, MemoryBus
from hilbench.can.wire import frame_bits
from hilbench.errors import BusError


def test_what_is_sent_before_anyone_looks_competes() -> None:
    bus = MemoryBus()
    one, two, listener = bus.open_link(), bus.open_link(), bus.open_link()
    one.send([Frame(0x300, b"a"), Frame(0x100, b"b")])
    two.send([Frame(0x200, b"c"), Frame(0x400 << 18 | EXTENDED_FLAG, b"d")])
    received = listener.receive(0.0)
    assert [frame.data for frame in received] == [b"c", b"a", b"b", b"d"]
    total = 0
    for frame in received:
        total += frame_bits(frame)
        assert frame.time_ns == 1000 * total
    assert bus.bits == total
    assert [frame.data for frame in one.receive(0.0)] == [b"c", b"d"]
    assert one.receive(0.0) == []


def test_filters_and_the_descriptor() -> None:
    bus = MemoryBus()
    sender, link = bus.open_link(), bus.open_link()
    link.set_filters([(0x80, 0x7FF)])
    sender.send([Frame(0x81, b"")])
    assert not select.select([link], [], [], 0)[0]
    sender.send([Frame(0x80, b"")])
    assert select.select([link], [], [], 0)[0]
    assert [frame.can_id for frame in link.receive(0.0)] == [0x80]
    assert not select.select([link], [], [], 0)[0]


def test_a_waiting_thread_is_woken() -> None:
    bus = MemoryBus()
    sender, link = bus.open_link(), bus.open_link()
    received: list[Frame] = []
    thread = threading.Thread(target=lambda: received.extend(link.receive(20.0)))
    thread.start()
    sender.send([Frame(0x1 | REMOTE_FLAG, bytes(2))])
    thread.join()
    assert [(frame.can_id, frame.data) for frame in received] == [(0x1 | REMOTE_FLAG, bytes(2))]


def test_who_does_not_read_loses_the_newest() -> None:
    bus = MemoryBus()
    sender, link = bus.open_link(), bus.open_link()
    sender.send([Frame(0x1, n.to_bytes(4, "big")) for n in range(RECEIVE_LIMIT + 5)])
    received = link.receive(0.0)
    assert (len(received), link.dropped) == (RECEIVE_LIMIT, 5)
    assert received[-1].data == (RECEIVE_LIMIT - 1).to_bytes(4, "big")


def test_last_frames_of_a_link_that_closes_go_out() -> None:
    bus = MemoryBus()
    sender, link = bus.open_link(), bus.open_link()
    sender.send([Frame(0x1, b"")])
    sender.close()
    sender.close()
    assert len(link.receive(0.0)) == 1
    with pytest.raises(BusError, match="closed"):
        sender.send([Frame(0x1, b"")])
    with pytest.raises(BusError, match="closed"):
        sender.receive(0.0)


def test_disturbances_repeat() -> None:
    def arrivals() -> list[bytes]:
        bus = MemoryBus()
        sender, link = bus.open_link(), bus.open_link()
        bus.inject_errors(ErrorInjection(seed=2, lost=0.5))
        sender.send([Frame(0x1, bytes([n])) for n in range(50)])
        return [frame.data for frame in link.receive(0.0)]

    assert arrivals() == arrivals()
    assert 5 < len(arrivals()) < 45


def test_refuses_what_no_wire_carries() -> None:
    bus = MemoryBus()
    with pytest.raises(ValueError, match="0x800"):
        bus.open_link().send([Frame(0x800, b"")])


def test_a_canopen_network_on_it() -> None:
    """canopen's own server and client, each on a station, exchange an SDO."""
    bus = MemoryBus()
    dictionary = canopen.ObjectDictionary()
    device_name = canopen.objectdictionary.ODVariable("device name", 0x1008)
    device_name.data_type = canopen.objectdictionary.VISIBLE_STRING
    device_name.default = "a text of more than four bytes"
    dictionary.add_object(device_name)
    server, client = canopen.Network(), canopen.Network()
    for network in (server, client):
        network.bus = bus.open_python_can()
        network.connect()
    server.add_node(canopen.LocalNode(5, dictionary))
    node = client.add_node(canopen.RemoteNode(5, dictionary))
    try:
        assert node.sdo["device name"].raw == "a text of more than four bytes"
    finally:
        for network in (client, server):
            network.disconnect()


def test_the_python_can_bus_filters_and_reports_errors() -> None:
    bus = MemoryBus()
    link = bus.open_link()
    with bus.open_python_can(can_filters=[{"can_id": 0x2, "can_mask": 0x7FF}]) as python_can:
        link.send([Frame(0x1, b""), Frame(0x2, b"x")])
        message = python_can.recv(0.0)
        assert message is not None
        assert (message.arbitration_id, bytes(message.data)) == (0x2, b"x")
        with pytest.raises(can.CanOperationError):
            python_can.send(can.Message(is_error_frame=True))


def test_what_was_received_does_not_grow_when_more_comes() -> None:
    bus = MemoryBus()
    sender, receiver = bus.open_link(), bus.open_link()
    nothing = receiver.receive(0.0)
    sender.send([Frame(0x1, b"")])
    assert len(receiver.receive(0.0)) == 1
    assert nothing == []
