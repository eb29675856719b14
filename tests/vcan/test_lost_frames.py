"""The kernel drops frames for a socket that is not read: our link counts every one of them.

The interface is named by HILBENCH_VCAN (a vcan, or a CAN controller with another one on its wire that answers).
"""

from __future__ import annotations

import os
import socket

import pytest

from hilbench.can.frame import Frame
from hilbench.can.open import BusAddress, open_link
from hilbench.can.socketcan import SocketCanLink

pytestmark = pytest.mark.vcan

SENT = 400


@pytest.fixture
def channel() -> str:
    return os.environ["HILBENCH_VCAN"]


def small_receive_buffer(link: SocketCanLink) -> None:
    """As small as the kernel makes it: room for a few frames."""
    duplicate = socket.socket(fileno=os.dup(link.fileno()))
    duplicate.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
    duplicate.close()


def test_every_frame_is_received_or_counted(channel: str) -> None:
    sender, receiver = (open_link(BusAddress("socketcan", channel)) for _ in range(2))
    assert isinstance(receiver, SocketCanLink)
    small_receive_buffer(receiver)
    frames = [Frame(0x181, number.to_bytes(2, "little")) for number in range(SENT)]
    sender.send(frames)
    received = receiver.receive(1.0)
    assert 0 < len(received) < SENT
    # No frame came after the losses, so that nothing but the socket itself knows of them.
    assert receiver.receive(0.0) == []
    assert receiver.dropped == SENT - len(received)
    # What was received is what came first, in order.
    assert [frame.data for frame in received] == [frame.data for frame in frames[: len(received)]]
    sender.close()
    receiver.close()
    assert receiver.dropped == SENT - len(received)


def test_the_next_frame_brings_the_count(channel: str) -> None:
    sender, receiver = (open_link(BusAddress("socketcan", channel)) for _ in range(2))
    assert isinstance(receiver, SocketCanLink)
    small_receive_buffer(receiver)
    sender.send([Frame(0x181, b"")] * SENT)
    before = len(receiver.receive(1.0))
    sender.send([Frame(0x182, b"")])
    assert [frame.can_id for frame in receiver.receive(1.0)] == [0x182]
    assert receiver.dropped == SENT - before
    sender.close()
    receiver.close()


def test_a_link_that_is_read_loses_nothing(channel: str) -> None:
    sender, receiver = (open_link(BusAddress("socketcan", channel)) for _ in range(2))
    for number in range(SENT):
        sender.send([Frame(0x181, number.to_bytes(2, "little"))])
        if number % 10 == 9:
            assert len(receiver.receive(1.0)) == 10
    assert receiver.dropped == 0
    sender.close()
    receiver.close()
