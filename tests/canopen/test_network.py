"""canopen's network on the buses of hilbench: who leaves waits for its thread, not for long."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

import can
from hilbench.can.memory import MemoryBus, MemoryCanBus
from hilbench.can.open import BusAddress, open_python_can
from hilbench.canopen.sdo_client import Network

BUSES: dict[str, Callable[[], can.BusABC]] = {
    "in memory": lambda: MemoryCanBus(MemoryBus("left", 1_000_000)),
    "embedded": lambda: open_python_can(BusAddress(channel="hilbench_left")),
}


@pytest.mark.parametrize("bus", BUSES)
def test_its_thread_has_ended_when_it_has_left(bus: str) -> None:
    before = set(threading.enumerate())
    network = Network(BUSES[bus]())
    network.connect()
    (receives,) = set(threading.enumerate()) - before
    network.disconnect()
    assert not receives.is_alive()
