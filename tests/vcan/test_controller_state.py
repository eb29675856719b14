"""What the kernel tells of its CAN controller: error message frames, put on a vcan as a driver would put them there.

The interface is named by HILBENCH_VCAN. Bytes as in <linux/can/error.h>.
"""

from __future__ import annotations

import os
import socket
import struct
from collections.abc import Iterator

import pytest

from hilbench.can.confinement import ControllerState
from hilbench.can.frame import Frame
from hilbench.can.open import BusAddress, open_link
from hilbench.can.socketcan import SocketCanLink
from hilbench.errors import BusError

pytestmark = pytest.mark.vcan

CONTROLLER, BUS_OFF, RESTARTED = 0x20000004, 0x20000040, 0x20000100
TRANSMIT_PASSIVE, ACTIVE = bytes((0, 0x20, 0, 0, 0, 0, 128, 0)), bytes((0, 0x40, 0, 0, 0, 0, 0, 0))


def set_value(can_id: int, data: bytes = bytes(8)) -> None:
    """As the driver of the controller."""
    with socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as driver:
        driver.bind((os.environ["HILBENCH_VCAN"],))
        driver.send(struct.pack("=IB3x8s", can_id, 8, data))


@pytest.fixture
def link() -> Iterator[SocketCanLink]:
    link = open_link(BusAddress("socketcan", os.environ["HILBENCH_VCAN"]))
    assert isinstance(link, SocketCanLink)
    yield link
    link.close()


def test_error_passive_is_known_and_its_end(link: SocketCanLink) -> None:
    set_value(CONTROLLER, TRANSMIT_PASSIVE)
    assert link.receive(0.1) == []
    assert link.controller is ControllerState.ERROR_PASSIVE
    set_value(CONTROLLER, ACTIVE)
    link.receive(0.1)
    assert link.controller is ControllerState.ERROR_ACTIVE


def test_bus_off_is_a_lost_bus_until_the_controller_is_restarted(link: SocketCanLink) -> None:
    set_value(BUS_OFF)
    with pytest.raises(BusError, match="bus off"):
        link.receive(0.1)
    assert link.controller is ControllerState.BUS_OFF
    set_value(RESTARTED)
    link.receive(0.1)
    assert link.controller is ControllerState.ERROR_ACTIVE
    with socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as other:
        other.bind((os.environ["HILBENCH_VCAN"],))
        other.send(struct.pack("=IB3x8s", 0x123, 2, b"ok"))
    assert [(frame.can_id, frame.data) for frame in link.receive(1.0)] == [(0x123, b"ok")]


def test_other_errors_are_none_of_the_controllers_states(link: SocketCanLink) -> None:
    set_value(0x20000008)  # protocol violation
    assert link.receive(0.05) == []
    assert link.controller is ControllerState.ERROR_ACTIVE
    link.send([Frame(0x1, b"")])
