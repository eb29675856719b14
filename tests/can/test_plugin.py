"""The python-can interface beyond python-can's own suite: processes, filters, own messages, discovery, errors."""

from __future__ import annotations

import select
import subprocess
import sys
import time
from typing import Any

import pytest

import can
from hilbench.can.disturbance import ErrorInjection
from hilbench.can.frame import Frame
from hilbench.can.hub_client import inject_errors
from hilbench.can.open import BusAddress, open_link, open_python_can

ECHO = """
import can
with can.Bus(interface="hilbench", channel="hilbench0") as bus:
    bus.send(can.Message(arbitration_id=0x700, is_extended_id=False))
    for message in bus:
        if message.arbitration_id == 0x7FF:
            break
        message.arbitration_id += 1
        bus.send(message)
"""


def message(can_id: int, data: bytes = b"", **options: Any) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False, **options)


def open_bus(**options: Any) -> can.BusABC:
    return can.Bus(interface="hilbench", channel="hilbench0", **options)


def test_another_process(runtime: Any) -> None:
    with open_bus() as bus:
        child = subprocess.Popen([sys.executable, "-c", ECHO])
        first = bus.recv(20)
        assert first is not None
        assert (first.arbitration_id, first.channel) == (0x700, "hilbench0")
        for n in range(10):
            bus.send(message(0x100, bytes([n])))
            answer = bus.recv(20)
            assert answer is not None
            assert (answer.arbitration_id, bytes(answer.data), answer.is_rx) == (0x101, bytes([n]), True)
            assert abs(answer.timestamp - time.time()) < 20
        bus.send(message(0x7FF))
        assert child.wait(20) == 0


def test_the_descriptor_is_readable_exactly_while_a_frame_waits(runtime: Any) -> None:
    link = open_link(BusAddress(timing="virtual"))
    with open_bus() as bus:
        assert not select.select([bus], [], [], 0)[0]
        link.send([Frame(n, b"") for n in range(3)])
        for n in range(3):
            assert select.select([bus], [], [], 20)[0]
            received = bus.recv(0)
            assert received is not None
            assert received.arbitration_id == n
        assert not select.select([bus], [], [], 0)[0]
    link.close()


def test_filters_know_identifiers_masks_and_formats(runtime: Any) -> None:
    frames = [message(0x123), can.Message(arbitration_id=0x123), message(0x124), message(0x7FF)]
    last = {"can_id": 0x7FF, "can_mask": 0x7FF}
    for entry, expected in (
        ({"can_id": 0x123, "can_mask": 0x7FF, "extended": False}, [(0x123, False)]),
        ({"can_id": 0x123, "can_mask": 0x7FF, "extended": True}, [(0x123, True)]),
        ({"can_id": 0x120, "can_mask": 0x7F0}, [(0x123, False), (0x123, True), (0x124, False)]),
    ):
        with open_bus(can_filters=[entry, last]) as bus, open_bus() as sender:
            for frame in frames:
                sender.send(frame)
            received: list[Any] = []
            while not received or received[-1].arbitration_id != 0x7FF:
                received.append(bus.recv(20))
            assert [(m.arbitration_id, m.is_extended_id) for m in received[:-1]] == expected


def test_own_messages_only_on_request(runtime: Any) -> None:
    with open_bus(receive_own_messages=True) as hearing, open_bus() as other:
        hearing.send(message(0x1))
        other.send(message(0x2))
        received = [hearing.recv(20), hearing.recv(20)]
        assert [(m.arbitration_id, m.is_rx) for m in received if m] == [(0x1, False), (0x2, True)]
        only = other.recv(20)
        assert only is not None
        assert only.arbitration_id == 0x1
        assert other.recv(0) is None


def test_periodic_sends(runtime: Any) -> None:
    with open_bus() as sender, open_bus() as bus:
        task = sender.send_periodic(message(0x80), 0.005)
        received = [bus.recv(20) for _ in range(5)]
        task.stop()
        assert all(m is not None and m.arbitration_id == 0x80 for m in received)


def test_notifier(runtime: Any) -> None:
    with open_bus() as sender, open_bus() as bus:
        reader = can.BufferedReader()
        notifier = can.Notifier(bus, [reader], timeout=0.05)
        sender.send(message(0x55))
        received = reader.get_message(20)
        notifier.stop()
        assert received is not None
        assert received.arbitration_id == 0x55


def test_running_buses_are_found(runtime: Any) -> None:
    assert can.detect_available_configs("hilbench") == []
    with open_bus():
        assert can.detect_available_configs("hilbench") == [{"interface": "hilbench", "channel": "hilbench0"}]


def test_fd_frames_reach_only_who_asked_for_them(runtime: Any) -> None:
    big = can.Message(arbitration_id=0x10, is_extended_id=False, is_fd=True, bitrate_switch=True, data=bytes(range(12)))
    with open_bus(fd=True) as sender, open_bus(fd=True) as modern, open_bus() as classical:
        sender.send(big)
        sender.send(message(0x11))
        first, second = modern.recv(20), modern.recv(20)
        assert first is not None
        assert first.equals(big, timestamp_delta=None, check_channel=False, check_direction=False)
        assert second is not None
        assert not second.is_fd
        only = classical.recv(20)
        assert only is not None
        assert only.arbitration_id == 0x11
        with pytest.raises(can.CanOperationError, match="fd=True"):
            classical.send(big)


def test_a_frame_no_wire_carries(runtime: Any) -> None:
    with open_bus() as bus, pytest.raises(can.CanOperationError, match="an error frame"):
        bus.send(can.Message(is_error_frame=True))


def test_another_bit_rate_is_refused(runtime: Any) -> None:
    with open_bus(bitrate=250_000), pytest.raises(can.CanInitializationError, match="bitrate is 250000"):
        open_bus(bitrate=500_000)


def test_disturbed_frames(runtime: Any) -> None:
    with open_bus() as sender, open_bus() as bus:
        inject_errors("hilbench0", ErrorInjection(lost=1.0, filters=((0x1, 0x7FF),)))
        sender.send(message(0x1))
        sender.send(message(0x2))
        received = bus.recv(20)
        assert received is not None
        assert received.arbitration_id == 0x2


def test_open_python_can(runtime: Any) -> None:
    address = BusAddress(bitrate=500_000, timing="virtual")
    link = open_link(address)
    bus = open_python_can(address, [{"can_id": 0x580, "can_mask": 0x780}])
    link.send([Frame(0x181, b""), Frame(0x581, bytes(8))])
    received = bus.recv(20)
    assert received is not None
    assert received.arbitration_id == 0x581
    bus.shutdown()
    link.close()
